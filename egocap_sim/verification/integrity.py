"""Check that a sequence on disk is complete, undamaged and consistent."""

from __future__ import annotations

import tarfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from itertools import product
from pathlib import Path

import numpy as np

from egocap.data.dataset import EPISODES, load_dataset
from egocap.data.manifest import MANIFEST, Manifest, ShardEntry, load_manifest
from egocap.data.sequence import Sequence
from egocap.data.sequence_writer import digest, file_is_intact, shard_is_intact
from egocap.data.truth import OUT_OF_VIEW, Truth
from egocap.errors import EgocapError
from egocap.files import sha256
from egocap.geometry import inverse, transform
from egocap.media.decoding import image_size
from egocap_sim.verification.crosscheck import RayCheck, check_forces, check_pixels, check_rays

_PIXEL_TOLERANCE = 1e-6  # px: truth and rig are both stored in full precision
_POSITION_TOLERANCE = 1e-9  # m
_LEAST_LABELLED, _LEAST_IN_DEPTH = 0.70, 0.85  # shares of the visible joints
_ENOUGH = 300  # joints; below that a share is not tested
_LEAST_BY_RAYS = 0.93  # share of joints with the same visibility
_FORCE_TOLERANCE = 0.10  # body weights, mean over a recording of two seconds and more


@dataclass(frozen=True)
class Verification:
    """The size of a recording and every problem found."""

    folder: Path
    frames: int
    shards: int
    bytes: int
    problems: tuple[str, ...]
    rays: RayCheck | None = None  # if requested and the sequence is complete

    @property
    def clean(self) -> bool:
        """Whether no problem was found."""
        return not self.problems


def frames_to_check(folder: str | Path, ray_frames: int = 0) -> int:
    """Number of frames that `verify` tells of. Raises FileError as `verify`."""
    folder = Path(folder)
    if (folder / EPISODES).exists():
        lengths = [entry.frames for entry in load_dataset(folder).episodes]
    else:
        lengths = [load_manifest(folder).frames]
    return sum(min(frames, ray_frames) if ray_frames else frames for frames in lengths)


def verify(
    folder: str | Path, ray_frames: int = 0, on_frames: Callable[[int], None] = lambda count: None
) -> Verification:
    """Check manifest, checksums, shard structure, images and truth of a sequence, or of episodes.

    With `ray_frames`, joint visibility is recomputed by rays in that many frames, in one to two
    seconds a frame. `on_frames` is called with the frames checked, those by rays if there are any.
    Raises FileError if the folder holds no sequence; lists any other problem.
    """
    folder = Path(folder)
    if (folder / EPISODES).exists():
        return _verify_episodes(folder, ray_frames, on_frames)
    manifest = load_manifest(folder)
    advance = (lambda count: None) if ray_frames else on_frames
    problems, rays = list(_problems(folder, manifest, advance)), None
    if ray_frames and not problems:
        rays = check_rays(Sequence(folder), ray_frames, on_frames)
        if rays.share < _LEAST_BY_RAYS:
            problems.append(f"truth.npz: 'visibility' differs from rays: {rays.text()}")
    size = sum(shard.bytes for shard in manifest.shards)
    size += sum(entry.bytes for entry in manifest.files.values())
    return Verification(folder, manifest.frames, len(manifest.shards), size, tuple(problems), rays)


def _verify_episodes(
    folder: Path, ray_frames: int, on_frames: Callable[[int], None]
) -> Verification:
    recording, problems = load_dataset(folder), []
    frames, shards, size = 0, 0, 0
    for entry in recording.episodes:
        manifest = folder / entry.name / MANIFEST
        if not manifest.exists():
            problems.append(f"{entry.name}: is missing")
            continue
        result = verify(folder / entry.name, ray_frames, on_frames)
        if sha256(manifest) != entry.sha256:
            problems.append(f"{entry.name}: its manifest differs from the recorded one")
        if result.frames != entry.frames:
            problems.append(f"{entry.name}: {result.frames} frames, {entry.frames} are recorded")
        problems += [f"{entry.name}: {problem}" for problem in result.problems]
        frames, shards, size = frames + result.frames, shards + result.shards, size + result.bytes
    names = {entry.name for entry in recording.episodes}
    unlisted = {path.name for path in folder.glob("episode-*")} - names
    problems += [f"{name}: is not in {EPISODES}" for name in sorted(unlisted)]
    if not recording.complete:
        problems.append(f"unfinished: {recording.frames - frames} of {recording.frames} frames "
                        "are not there yet")  # fmt: skip
    elif [entry.index for entry in recording.episodes] != list(range(len(recording.episodes))):
        problems.append(f"{EPISODES}: its episodes are not numbered consecutively")
    return Verification(folder, frames, shards, size, tuple(problems))


def _problems(folder: Path, manifest: Manifest, on_frames: Callable[[int], None]) -> Iterator[str]:
    if digest(manifest.config) != manifest.config_sha256:
        yield "manifest.json: the configuration does not match its checksum"
    damaged = False  # damaged files are not opened
    for name, entry in manifest.files.items():
        if not file_is_intact(folder / name, entry):
            damaged = True
            yield f"{name}: {_state(folder / name)}"
    for shard in manifest.shards:
        if shard_is_intact(folder, shard):
            yield from _shard_problems(folder, shard)
        else:
            damaged = True
            yield f"{shard.name}: {_state(folder / shard.name)}"
    missing = manifest.shard_count - len(manifest.shards)
    if missing:
        yield f"unfinished: {missing} of {manifest.shard_count} shards are not there yet"
    elif not manifest.complete:
        yield f"unfinished: {manifest.last_file} is not there yet"
    elif not damaged:
        try:
            sequence = Sequence(folder)
            wrong = list(_image_problems(sequence, on_frames))
            yield from wrong
            if wrong or not manifest.truth:
                return
            contradictions = list(_truth_problems(sequence)) or list(_annotation_problems(sequence))
            yield from contradictions or _crosscheck_problems(sequence)
        except EgocapError as error:
            yield str(error)


def _state(path: Path) -> str:
    return "its bytes do not match the recorded checksum" if path.exists() else "is missing"


def _shard_problems(folder: Path, shard: ShardEntry) -> Iterator[str]:
    """Compare the tar's members with the manifest's index."""
    try:
        with tarfile.open(folder / shard.name, "r:") as tar:
            listed = {member.name: (member.offset_data, member.size) for member in tar}
    except (tarfile.TarError, ValueError, EOFError, OverflowError) as error:
        yield f"{shard.name}: not a whole tar archive: {error}"
        return
    indexed = {
        f"{shard.first + row:06d}.{suffix}": place
        for row, files in enumerate(shard.frames)
        for suffix, place in files.items()
    }
    if listed != indexed:
        names = sorted(listed.keys() ^ indexed.keys()) or ["offsets"]
        yield f"{shard.name}: its members differ from the manifest's index ({names[0]})"


def _image_problems(sequence: Sequence, on_frames: Callable[[int], None]) -> Iterator[str]:
    """Compare every image's header with the rig, and decode the first frame of every shard."""
    if not sequence.manifest.shards_hold_images:
        return
    for shard in sequence.manifest.shards:
        found: dict[str, list[int]] = {}
        for index in range(shard.first, shard.first + len(shard.frames)):
            for problem in _frame_problems(sequence, index):
                found.setdefault(problem, []).append(index)
        for problem, frames in found.items():
            more = f" and {len(frames) - 1} more" if len(frames) > 1 else ""
            yield f"{shard.name}: {problem} in frame {frames[0]}{more}"
        if not found:
            sequence.frame(shard.first)  # raises FileError for what cannot be decoded
            for view, plane in product(sequence.manifest.views, (sequence.mask, sequence.depth)):
                plane(shard.first, view)
        on_frames(len(shard.frames))


def _frame_problems(sequence: Sequence, index: int) -> Iterator[str]:
    """Missing files, and images of another size than their camera.

    Every frame of a simulated sequence has the files of the first, which has all pictures.
    """
    files, views = sequence.files(index), sequence.manifest.views
    if sequence.manifest.truth:
        first = sequence.files(0).keys()
        yield from (f"no '{s}'" for s in sorted(first - files.keys()))
        yield from (f"'{s}', which frame 0 lacks," for s in sorted(files.keys() - first))
        if index == 0:
            absent = [v for v in range(len(views)) if sequence.image_suffix(0, v) is None]
            yield from (f"no picture of '{views[v]}'" for v in absent)
    for name, camera in zip(views, sequence.rig.cameras, strict=True):
        for suffix in files:
            if suffix.startswith(f"{name}."):
                size = image_size(sequence.read(index, suffix), sequence.shard_path(index))
                if size is None:
                    yield f"'{suffix}' is damaged"
                elif size != (camera.width, camera.height):
                    yield (f"'{suffix}' has {size[0]} x {size[1]} pixels (camera: "
                           f"{camera.width} x {camera.height})")  # fmt: skip


def _crosscheck_problems(sequence: Sequence) -> Iterator[str]:
    """Compare the truth with the recorded planes and Newton's law."""
    pixels = check_pixels(sequence)
    if pixels.joints >= _ENOUGH and pixels.labelled_share < _LEAST_LABELLED:
        yield (
            f"truth.npz: {100 * pixels.labelled_share:.1f} % of the visible joints have their body "
            f"at their pixel, fewer than {100 * _LEAST_LABELLED:g} %"
        )
    if pixels.measured >= _ENOUGH and pixels.depth_share < _LEAST_IN_DEPTH:
        yield (
            f"truth.npz: {100 * pixels.depth_share:.1f} % of the visible joints lie just behind "
            f"the recorded surface, fewer than {100 * _LEAST_IN_DEPTH:g} %"
        )
    forces = check_forces(sequence)
    if forces is not None and abs(forces.applied - forces.required) > max(
        _FORCE_TOLERANCE, 4.0 * forces.error
    ):
        yield (
            f"truth.npz: ground and root apply {forces.applied:.2f} body weights on average, "
            f"the motion requires {forces.required:.2f}"
        )


def _truth_problems(sequence: Sequence) -> Iterator[str]:
    """Check that the truth is finite, complete and geometrically consistent."""
    truth = sequence.truth
    if len(truth.time) != len(sequence):
        yield f"truth.npz: {len(truth.time)} frames, the manifest has {len(sequence)}"
        return
    for field in fields(Truth):
        values = getattr(truth, field.name)
        if field.name == "joints_2d":
            values = values[truth.in_view]
        if not np.isfinite(values).all():
            yield f"truth.npz: '{field.name}' has values that are not finite"
            return
    world = transform(truth.T_world_head, truth.joints_head)
    if np.abs(world - truth.joints_world).max() > _POSITION_TOLERANCE:
        yield "truth.npz: the head-frame joints do not map to 'joints_world'"
    sensor = sequence.sensor
    if sensor is not None and sensor.joint_time.shape != truth.in_view.shape:
        yield f"sensor.npz: 'joint_time' has the shape {sensor.joint_time.shape}"
        return
    at_once = sensor is None or (sensor.joint_time == truth.time[:, None, None])
    for v, mount in enumerate(sequence.true_rig.mounts):
        seen = transform(inverse(mount.T_head_camera), truth.joints_head)
        if not np.all(at_once):  # each joint at the time at which its row was exposed
            seen = truth.joints_camera[:, v]
        pixels, valid = mount.camera.project(seen)
        if not np.array_equal(valid, truth.in_view[:, v]):
            yield f"truth.npz: 'in_view' of {mount.name} does not follow from the rig"
        elif np.abs(pixels - truth.joints_2d[:, v])[valid].max(initial=0) > _PIXEL_TOLERANCE:
            yield f"truth.npz: 'joints_2d' of {mount.name} does not follow from the rig"
    if not np.array_equal(truth.visibility == OUT_OF_VIEW, ~truth.in_view):
        yield "truth.npz: 'visibility' contradicts 'in_view'"


def _annotation_problems(sequence: Sequence) -> Iterator[str]:
    """Compare joints and visibility in the annotations of simulated frames with the truth."""
    if "scene.toml" not in sequence.manifest.files:
        return
    truth, views = sequence.truth, sequence.manifest.views
    for shard in sequence.manifest.shards:
        for index in range(shard.first, shard.first + len(shard.frames)):
            said = sequence.annotation(index)
            visibility = dict(zip(views, truth.visibility[index].tolist(), strict=True))
            joints = truth.joints_head[index].tolist()
            wrong = [key for key, true in (("visibility", visibility), ("joints_head", joints))
                     if said.get(key) != true]  # fmt: skip
            if wrong:
                yield f"{shard.name}: '{wrong[0]}' of frame {index} differs from truth.npz"
                break
