"""Rendering on a Dask cluster: the drafts travel to the workers, finished shards back.

No folder need be shared; every machine needs this program in the same version, the files that the
scene names, and, for the same bytes as here, the same GL driver. Dask gives the shards of a worker
that dies to another. Needs the extra `egocap[cluster]`.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from egocap.errors import MachineError
from egocap.sequence import ShardEntry
from egocap.sequence_writer import write_atomically, write_shard
from egocap_sim.scene import Scene
from egocap_sim.sensor.film import DRAFTS
from egocap_sim.version import code_version
from egocap_sim.workers import DRAFT, make_frames

if TYPE_CHECKING:
    from egocap_sim.frames import FrameMaker

_PATIENCE_S = 10  # for the scheduler to answer

Drafts = dict[str, bytes]


def render_on_cluster(
    address: str,
    scene: Scene,
    out: Path,
    pending: list[tuple[int, range]],
    enter: Callable[[ShardEntry], None],
) -> None:
    """Render shards on the cluster of a scheduler, and enter each as it arrives.

    Raises MachineError where there is no such scheduler, Dask is not installed, or a shard's
    workers keep dying.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError:
        raise MachineError(
            "Dask is not installed", remedy="pip install 'egocap[cluster]'"
        ) from None
    drafts = {name: (out / name).read_bytes() for name in (DRAFT, *DRAFTS)
              if (out / name).exists()}  # fmt: skip
    task = hashlib.sha256(repr(scene).encode() + b"".join(drafts.values())).hexdigest()
    try:
        client = Client(address, timeout=_PATIENCE_S)
    except (OSError, ValueError) as error:
        reason = str(error) or type(error).__name__
        raise MachineError(f"no Dask scheduler at '{address}': {reason}") from None
    with client:
        sent = client.scatter(drafts, broadcast=True, hash=False) if pending else {}
        futures = [
            client.submit(
                render_remotely, task, code_version(), scene, sent, index, frames,
                key=f"egocap-{task[:16]}-{index}", pure=False,
            )
            for index, frames in pending
        ]  # fmt: skip
        try:
            for future, result in as_completed(futures, with_results=True, raise_errors=True):
                entry, content = result
                write_atomically(out / entry.name, content)
                enter(entry)
                future.release()
        except KilledWorker as error:
            raise MachineError(f"the workers of a shard keep dying: {error}") from None
        finally:
            client.cancel(futures)


_thread = ThreadPoolExecutor(1)  # a GL context belongs to one thread; Dask has several
_held: tuple[str, FrameMaker] | None = None  # this worker's renderer, and the task it is for


def render_remotely(
    task: str, version: str, scene: Scene, drafts: Drafts, index: int, frames: range
) -> tuple[ShardEntry, bytes]:
    """One shard and its entry, in a worker. Raises MachineError in one of another version."""
    if version != code_version():
        raise MachineError(f"a worker runs version {code_version()}, not {version}")
    return _thread.submit(_render, task, scene, drafts, index, frames).result()


def _render(
    task: str, scene: Scene, drafts: Drafts, index: int, frames: range
) -> tuple[ShardEntry, bytes]:
    global _held
    if _held is None or _held[0] != task:
        if _held is not None:
            _held[1].close()
            _held = None
        with tempfile.TemporaryDirectory(prefix="egocap-") as folder:
            for name, content in drafts.items():
                (Path(folder) / name).write_bytes(content)
            _held = task, make_frames(scene, Path(folder))
    maker = _held[1]
    with tempfile.TemporaryDirectory(prefix="egocap-") as folder:
        entry = write_shard(Path(folder), index, frames.start, (maker.files(i) for i in frames))
        return entry, (Path(folder) / entry.name).read_bytes()
