"""Rendering on a Dask cluster, one of whose workers is killed; and a local worker that dies."""

import hashlib
import os
import signal
from pathlib import Path

import pytest

from egocap.errors import MachineError
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import Scene
from egocap_sim.verification.integrity import verify


def checksums(folder: Path) -> dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.iterdir()}


@pytest.fixture
def faulty(tiny_scene: Scene) -> Scene:
    """The tiny scene with everything that workers need to be told."""
    sensor = {"shutter_s": 0.01, "time_offset_s": 0.01, "read_noise": 0.01}
    return Scene.model_validate(tiny_scene.model_dump(exclude_none=True) | {"sensor": sensor})


def test_a_cluster_that_loses_a_worker_writes_the_same_bytes(faulty, tmp_path):
    distributed = pytest.importorskip("distributed")
    generate(faulty, tmp_path / "local", workers=0)
    entered: list[int] = []
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=2, dashboard_address=None, silence_logs=50
    ) as cluster:

        def kill_one(frames: int) -> None:
            entered.append(frames)
            if len(entered) == 2:  # the first call tells of earlier runs
                os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

        address = cluster.scheduler_address
        generate(faulty, tmp_path / "cluster", cluster=address, on_frames=kill_one)
    assert entered[0] == 0 and sorted(entered[1:]) == [1, 2, 2, 2]  # each shard once
    assert checksums(tmp_path / "cluster") == checksums(tmp_path / "local")
    assert verify(tmp_path / "cluster").clean


def test_no_scheduler_is_the_machines_fault(tiny_scene, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("egocap.execution.cluster._TIMEOUT_S", 1)
    with pytest.raises(MachineError, match="no Dask scheduler at 'tcp:"):
        generate(tiny_scene, tmp_path / "none", cluster="tcp://127.0.0.1:1")


def test_a_local_worker_that_dies_is_replaced(tiny_scene, tiny_sequence, tmp_path):
    entered: list[int] = []

    def kill_all(frames: int) -> None:
        entered.append(frames)
        if len(entered) == 2:
            import multiprocessing

            for child in multiprocessing.active_children():
                os.kill(child.pid, signal.SIGKILL)

    generate(tiny_scene, tmp_path / "s", workers=2, on_frames=kill_all)
    assert sum(entered) == tiny_scene.frames
    assert checksums(tmp_path / "s") == checksums(tiny_sequence)
