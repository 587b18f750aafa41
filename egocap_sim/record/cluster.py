"""Rendering on a Dask cluster: the drafts travel to the workers, finished shards back.

No folder need be shared; every machine needs this program in the same version, the files that the
scene names, and, for the same bytes as here, the same GL driver. Dask gives the shards of a worker
that dies to another. Needs the extra `egocap[cluster]`.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egocap.data.dataset import EpisodeEntry
from egocap.data.sequence import ShardEntry
from egocap.data.sequence_writer import write_shard
from egocap.errors import MachineError
from egocap.files import write_atomically
from egocap_sim.core.version import code_version
from egocap_sim.record.workers import DRAFT, make_frames
from egocap_sim.scene.config import Scene
from egocap_sim.sensor.plan import DRAFTS

if TYPE_CHECKING:
    from egocap_sim.record.episode_plan import Episode, Recorded
    from egocap_sim.record.frame_writer import FrameMaker

_PATIENCE_S = 10  # for the scheduler to answer
_ATTEMPTS = 8
"""At what the cluster loses: what goes along with jobs is lost with the last worker that has it."""

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
    drafts = {name: (out / name).read_bytes() for name in (DRAFT, *DRAFTS)
              if (out / name).exists()}  # fmt: skip
    task = hashlib.sha256(repr(scene).encode() + b"".join(drafts.values())).hexdigest()

    left = {frames.start: (index, frames) for index, frames in pending}

    def submit(client: Any, attempt: int) -> list[Any]:
        sent = client.scatter(drafts, broadcast=True, hash=False)
        return [
            client.submit(
                render_remotely, task, code_version(), scene, sent, index, frames,
                key=f"egocap-{task[:16]}-{index}-{attempt}", pure=False,
            )
            for index, frames in left.values()
        ]  # fmt: skip

    def place(result: tuple[ShardEntry, bytes]) -> None:
        entry, content = result
        write_atomically(out / entry.name, content)
        enter(entry)
        del left[entry.first]

    _work_through(address, left, submit, place)


def record_on_cluster(
    address: str,
    scene: Scene,
    out: Path,
    left: Mapping[int, Episode],
    clips: tuple[Recorded, ...],
    enter: Callable[[EpisodeEntry], None],
) -> None:
    """Make episodes on the cluster of a scheduler, and enter each as it arrives.

    Raises MachineError as `render_on_cluster`.
    """
    from egocap_sim.record.episode_recorder import place_files

    task = hashlib.sha256(repr((scene, clips)).encode()).hexdigest()
    left = dict(left)

    def submit(client: Any, attempt: int) -> list[Any]:
        return [
            client.submit(
                record_remotely, code_version(), scene, episode, clips,
                key=f"egocap-{task[:16]}-episode-{index}-{attempt}", pure=False,
            )
            for index, episode in left.items()
        ]  # fmt: skip

    def place(result: tuple[int, dict[str, bytes]]) -> None:
        index, files = result
        enter(place_files(files, out, index))
        del left[index]

    _work_through(address, left, submit, place)


def _work_through(
    address: str,
    left: Mapping[int, Any],
    submit: Callable[[Any, int], list[Any]],
    place: Callable[[Any], None],
) -> None:
    """Submit the jobs that are left until `place`, which takes them away, has had each result."""
    with _client(address) as client:
        for attempt in range(_ATTEMPTS):
            if not left:
                return
            _gather(client, submit(client, attempt), place)
    if left:
        raise MachineError(f"the cluster lost what {len(left)} jobs need, {_ATTEMPTS} times")


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise MachineError(
            "Dask is not installed", remedy="pip install 'egocap[cluster]'"
        ) from None
    try:
        return Client(address, timeout=_PATIENCE_S)
    except (OSError, ValueError) as error:
        reason = str(error) or type(error).__name__
        raise MachineError(f"no Dask scheduler at '{address}': {reason}") from None


def _gather(client: Any, futures: list[Any], place: Callable[[Any], None]) -> None:
    """Place the results of futures as they arrive; those whose input the cluster lost have none."""
    from distributed import KilledWorker, as_completed

    try:
        for future, result in as_completed(futures, with_results=True, raise_errors=True):
            if not future.cancelled():
                place(result)
            future.release()
    except KilledWorker as error:
        raise MachineError(f"the workers of a shard keep dying: {error}") from None
    finally:
        client.cancel(futures)


def record_remotely(
    version: str, scene: Scene, episode: Episode, clips: tuple[Recorded, ...]
) -> tuple[int, dict[str, bytes]]:
    """One episode's files, in a worker. Raises MachineError in one of another version."""
    from egocap_sim.record.episode_recorder import episode_files

    if version != code_version():
        raise MachineError(f"a worker runs version {code_version()}, not {version}")
    return episode.index, _thread.submit(episode_files, scene, episode, clips).result()


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
