"""Pictures of a board, read from a folder or a video per camera and matched between them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap.errors import FileError, InputError
from egocap.files import read_bytes
from egocap.media.decoding import decode
from egocap.media.video import open_video
from egocap.series import nearest

SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm")
MOST_VIEWS = 16
MOST_FRAMES = 120  # of a video
_APART_S = 0.012  # between frames that count as of the same instant
_APART_IN_THREES_S = 0.002  # where lags or readout times are sought
_NAME = re.compile(r"[^A-Za-z0-9_-]+")


@dataclass(frozen=True, eq=False)
class View:
    """The pictures of one camera."""

    name: str
    size: tuple[int, int]  # width, height
    pictures: dict[int, UInt8[Array, "H W"]]  # by instant
    source: Path


@dataclass(frozen=True, eq=False)
class Recording:
    """The views of a rig. Pictures of the same instant were taken together."""

    views: tuple[View, ...]
    labels: tuple[str, ...]  # of the instants, for messages
    times: Float[Array, "I"] | None = None  # of the instants of videos, seconds


def read_recording(sources: Sequence[Path], in_threes: bool = False) -> Recording:
    """Read a folder of pictures, or a video, per camera.

    Pictures with the same name are of the same instant, or those with the same last number in their
    names where few share a name; so are frames of videos at the same time from their starts.
    `in_threes`: take frames of videos three in a row. Raises FileError for folders without
    pictures, unreadable pictures and mixed sizes, InputError for no source or two of the same name.
    """
    if not 1 <= len(sources) <= MOST_VIEWS:
        raise InputError(f"{len(sources)} sources", valid="a folder or video per camera, 1 to 16")
    if all(source.is_file() for source in sources):
        return _read_videos(sources, in_threes)
    files = [_picture_files(source) for source in sources]
    keys = _matched([[file.stem for file in each] for each in files])
    labels = sorted({key for each in keys for key in each}, key=_natural)
    index = {label: i for i, label in enumerate(labels)}
    names = _view_names(sources)
    views = []
    for source, name, found, own in zip(sources, names, files, keys, strict=True):
        pictures = _read_pictures(found)
        height, width = pictures[0].shape
        by_instant = {index[key]: picture for key, picture in zip(own, pictures, strict=True)}
        views.append(View(name, (width, height), by_instant, source))
    return Recording(tuple(views), tuple(labels))


def read_picture(path: Path) -> UInt8[Array, "H W"]:
    """Decode a picture to grey values. Raises FileError."""
    picture = decode(read_bytes(path), cv2.IMREAD_GRAYSCALE, path)
    if picture is None:
        raise FileError(path, "is not a readable picture", valid=f"files in {', '.join(SUFFIXES)}")
    return picture


def _picture_files(source: Path) -> list[Path]:
    if not source.exists():
        raise FileError(source, "no such file", valid="a folder of pictures or a video per camera")
    if not source.is_dir():
        raise FileError(source, "is not a folder", valid="folders of pictures alone, or videos")
    found = [p for p in source.iterdir() if p.suffix.lower() in SUFFIXES]
    if not found:
        inner = sorted(p.name for p in source.iterdir() if p.is_dir())
        hint = f"one of its folders ({', '.join(inner[:4])})" if inner else "a folder of pictures"
        raise FileError(source, "has no pictures", valid=hint)
    return sorted(found, key=lambda p: _natural(p.stem))


def _read_videos(sources: Sequence[Path], in_threes: bool) -> Recording:
    """Frames of videos that started together, spread evenly over the first one."""
    videos = [open_video(source) for source in sources]
    first = videos[0].times - videos[0].times[0]
    wanted = first[_spread(len(first), in_threes)]
    apart = _APART_IN_THREES_S if in_threes else _APART_S
    views = []
    for source, name, video in zip(sources, _view_names(sources), videos, strict=True):
        times = video.times - video.times[0]
        places = nearest(times, wanted)
        late = np.abs(times[places] - wanted) > apart
        pictures = {i: video.image(int(at)) for i, at in enumerate(places) if not late[i]}
        grey = {i: cv2.cvtColor(p, cv2.COLOR_RGB2GRAY) for i, p in pictures.items()
                if p is not None}  # fmt: skip
        views.append(View(name, video.size, grey, source))
        video.close()
    return Recording(tuple(views), tuple(f"{time:.2f} s" for time in wanted), wanted)


def _spread(frames: int, in_threes: bool) -> Int[Array, "_"]:
    """Places of at most `MOST_FRAMES` frames of a video, alone or three in a row."""
    if not in_threes:
        return np.unique(np.linspace(0, frames - 1, MOST_FRAMES).astype(int))
    middle = np.linspace(1, frames - 2, MOST_FRAMES // 3).astype(int)
    places = np.unique(middle[:, None] + np.arange(-1, 2))
    return places[(places >= 0) & (places < frames)]


def _read_pictures(files: list[Path]) -> list[UInt8[Array, "H W"]]:
    pictures = [read_picture(file) for file in files]
    shape = pictures[0].shape
    for file, picture in zip(files, pictures, strict=True):
        if picture.shape != shape:
            sizes = f"is {picture.shape[1]} x {picture.shape[0]} pixels, and {files[0].name} "
            raise FileError(file, f"{sizes}{shape[1]} x {shape[0]}",
                            valid="one camera, one mode, not cropped")  # fmt: skip
    return pictures


def _matched(stems: list[list[str]]) -> list[list[str]]:
    """A label of the instant of every picture: its name, or the last number in it.

    Names count where most pictures share theirs, or where numbers match no more of them.
    """
    numbers = [[_last_number(stem) for stem in each] for each in stems]
    unique = all(len(set(each)) == len(each) for each in numbers)
    same, alike = (len(set.intersection(*map(set, each))) for each in (stems, numbers))
    most = 2 * same > min(map(len, stems))
    return numbers if unique and alike > same and not most else stems


def _last_number(stem: str) -> str:
    """The last number in a name, without leading zeros; the name where there is none."""
    digits = re.findall(r"\d+", stem)
    return str(int(digits[-1])) if digits else stem


def _natural(text: str) -> list[tuple[int, int, str]]:
    """Sorting key by which 2 comes before 10."""
    words = re.split(r"(\d+)", text)
    return [(0, int(w), "") if w.isdigit() else (1, 0, w) for w in words]


def _view_names(sources: Sequence[Path]) -> list[str]:
    names = [_NAME.sub("_", source.resolve().stem)[:40] or "camera" for source in sources]
    if len(set(names)) < len(names):
        names = [_NAME.sub("_", "_".join(s.resolve().with_suffix("").parts[-2:]))[-40:]
                 for s in sources]  # fmt: skip
    if len(set(names)) < len(names):
        raise InputError(f"two sources have the name '{names[0]}'", valid="different folders")
    return names
