"""A recording of a data set as a sequence without truth, for every command that takes one.

Pictures stay in the data set's folders where each view has a folder of its own; otherwise they are
copied into shards, without being compressed again.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import egocap
from egocap.data.footage import FOOTAGE, TIMES, Footage, FootageView, FrameTimes
from egocap.data.manifest import SCHEMA, Manifest
from egocap.data.sequence import Sequence, open_sequence
from egocap.data.sequence_writer import SequenceWriter, digest, write_shard
from egocap.datasets.pictures import Picture
from egocap.datasets.recording import Recording
from egocap.errors import FileError, InputError
from egocap.media.pictures import PictureOptions, open_pictures

SHARD_FRAMES = 50
_PNG, _JPEG = b"\x89PNG", b"\xff\xd8\xff"


def import_recording(
    recording: Recording,
    out: str | Path,
    *,
    copy: bool = False,
    on_frames: Callable[[int], None] = lambda count: None,
) -> Sequence:
    """Write a recording as a sequence folder; the same call completes an interrupted one.

    Its labels are not part of the sequence: `evaluate_recording` scores a track against them.

    Raises:
        InputError: the pictures must be copied, or `out` holds something else.
        FileError: a picture is missing or damaged.
    """
    out = Path(out)
    source = np.zeros((len(recording), len(recording.rig.views)), np.int64)
    if not copy:
        source = np.stack([_places(recording, v) for v in range(source.shape[1])], 1)
    footage = Footage(views=tuple(_view(recording, v) for v in range(source.shape[1])))
    taken = np.repeat(recording.times[:, None], source.shape[1], 1)
    times = FrameTimes(recording.times, taken, source, np.ones(source.shape, bool))
    config = {"dataset": recording.dataset, "sequence": recording.name, "copy": copy,
              "rig": recording.rig.to_dict(), "frames": list(recording.frames),
              "pictures": [view.sha256 for view in footage.views]}  # fmt: skip
    files = {
        "rig.json": (json.dumps(recording.rig.to_dict(), indent=1) + "\n").encode(),
        FOOTAGE: (footage.model_dump_json(indent=1) + "\n").encode(), TIMES: times.content(),
    }  # fmt: skip
    with SequenceWriter(out, _manifest(recording, copy, config), files) as writer:
        writer.begin()
        for shard in writer.pending():
            rows = writer.shard_range(shard)
            frames = (_copied(recording, i, on_frames) for i in rows)
            writer.add_shard(write_shard(out, shard, rows.start, frames))
    return open_sequence(out)


def _manifest(recording: Recording, copy: bool, config: dict[str, Any]) -> Manifest:
    return Manifest(
        schema_version=SCHEMA, name=recording.name, fps=recording.rig.frame_rate,
        frames=len(recording), shard_frames=SHARD_FRAMES, views=recording.rig.views, seed=0,
        truth=False, shards_hold_images=copy, config=config, config_sha256=digest(config),
        code_version=egocap.__version__,
    )  # fmt: skip


def _places(recording: Recording, v: int) -> np.ndarray:
    """Places of a view's pictures in their folder. Raises InputError where it has none."""
    pictures = [row[v] for row in recording.pictures]
    folder = pictures[0].path.parent
    usable = all(p.path.parent == folder and not p.member and not p.mirrored for p in pictures)
    try:
        opened = open_pictures(folder, PictureOptions(fps=recording.rig.frame_rate))
    except FileError:
        usable = False
    if not usable:
        raise InputError(f"{recording.name}: the pictures of '{recording.rig.views[v]}' are not a "
                         "folder of image files", valid="--copy")  # fmt: skip
    place = {path: i for i, path in enumerate(opened.files)}
    return np.array([place[picture.path] for picture in pictures])


def _view(recording: Recording, v: int) -> FootageView:
    """Where the pictures of a view are. The checksum is of their names: data sets do not change."""
    pictures = [row[v] for row in recording.pictures]
    first, options = pictures[0], PictureOptions(fps=recording.rig.frame_rate)
    names = [[str(p.path), p.member, p.row, p.mirrored] for p in pictures]
    path = first.path if first.member else first.path.parent
    return FootageView(name=recording.rig.views[v], path=str(path.resolve()), options=options,
                       bytes=0, sha256=digest({"pictures": names}))  # fmt: skip


def _copied(recording: Recording, index: int, on_frames: Callable[[int], None]) -> dict[str, bytes]:
    """Files of one frame."""
    files = {}
    views = zip(recording.rig.views, recording.pictures[index], recording.rig.cameras, strict=True)
    for name, picture, camera in views:
        picture.read(camera)  # raises for a damaged picture, or one of another size
        suffix, data = _encoded(picture)
        files[f"{name}.{suffix}"] = data
    files["json"] = json.dumps({"time": float(recording.times[index]),
                                "frame": recording.frames[index]}).encode()  # fmt: skip
    on_frames(1)
    return files


def _encoded(picture: Picture) -> tuple[str, bytes]:
    """Suffix and bytes: the file's own, or PNG of what no image file holds as it is."""
    import cv2

    data = b"" if picture.row is not None or picture.mirrored else picture.content()
    if data.startswith(_PNG):
        return "png", data
    if data.startswith(_JPEG):
        return "jpg", data
    done, encoded = cv2.imencode(".png", picture.read()[..., ::-1])
    assert done
    return "png", encoded.tobytes()
