"""Cameras and video files that run at their own pace, read by a thread each.

A source holds one picture: a newer one takes the place of one that nobody fetched, so that a slow
tracker skips frames and never falls behind.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.errors import InputError

if TYPE_CHECKING:
    import cv2

_LARGEST_SIDE = 1 << 14  # pixels
_DEVICES = Path("/sys/class/video4linux")
_MANUAL_EXPOSURE = 1.0  # of Video4Linux and of OpenCV's property
_STATED_S = 1.0  # age of a picture above which its stated time is of another clock
_TRIED = 10  # numbers of cameras, where the system does not list them


@dataclass(frozen=True)
class CameraSettings:
    """What to ask of cameras; files have their own."""

    size: tuple[int, int] | None = None
    """Width and height of the cameras' pictures."""
    fps: float | None = None
    """Pictures per second of the cameras."""
    exposure: float | None = None
    """Exposure of the cameras in their drivers' unit, instead of automatic exposure."""

    def __post_init__(self) -> None:
        if self.size is not None and not all(1 <= side <= _LARGEST_SIDE for side in self.size):
            raise InputError(f"--size {self.size[0]} {self.size[1]}", valid=f"1 to {_LARGEST_SIDE}")
        if self.fps is not None and not 0.1 <= self.fps <= 10_000.0:
            raise InputError(f"--fps {self.fps:g}", valid="0.1 to 10000")
        if self.exposure is not None and not isfinite(self.exposure):
            raise InputError(f"--exposure {self.exposure}", valid="a finite number")


@dataclass(frozen=True)
class CameraEntry:
    """A camera of this machine."""

    number: int
    name: str
    size: tuple[int, int] | None  # None: in use, or no pictures
    fps: float


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture and when it was taken."""

    image: UInt8[Array, "H W 3"]  # RGB
    taken: float  # s, `time.monotonic`


class Source:
    """A camera or a video file, read at its own pace; holds the newest picture only.

    A file plays from `start`, in the time of `time.monotonic`; by default from now. Raises
    InputError for one that cannot be opened, or a camera that refuses the settings.
    """

    def __init__(
        self, name: str, settings: CameraSettings = CameraSettings(), start: float | None = None
    ) -> None:
        import cv2

        self.name, self._start = name, time.monotonic() if start is None else start
        self._video = _opened(name, settings)
        rate = float(self._video.get(cv2.CAP_PROP_FPS))
        # A camera keeps its own pace; a file has none but its rate.
        self._period = 0.0 if name.isdigit() else 1.0 / (rate if rate > 0.0 else 30.0)
        self._fresh = threading.Condition()
        self._picture: Picture | None = None
        self.ended, self.taken, self.skipped = False, 0, 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._read, name=f"source {name}", daemon=True)
        self._thread.start()

    def newest(self, timeout: float) -> Picture | None:
        """The newest picture nobody fetched; None when the source has ended or nothing came."""
        with self._fresh:
            self._fresh.wait_for(lambda: self._picture is not None or self.ended, timeout)
            picture, self._picture = self._picture, None
            return picture

    @property
    def exhausted(self) -> bool:
        """Whether it has ended and its last picture was fetched."""
        with self._fresh:
            return self.ended and self._picture is None

    def close(self) -> None:
        """Stop reading."""
        self._stop.set()
        self._thread.join()
        self._video.release()

    def _read(self) -> None:
        import cv2

        count = 0
        while not self._stop.is_set():
            there, image = self._video.read()
            if not there:
                break
            count += 1
            if self._period:
                taken = self._start + count * self._period
                self._stop.wait(max(taken - time.monotonic(), 0.0))
            else:
                taken = _exposed(self._video)
            self._put(Picture(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), taken))
        with self._fresh:
            self.ended = True
            self._fresh.notify_all()

    def _put(self, picture: Picture) -> None:
        with self._fresh:
            self.skipped += self._picture is not None
            self.taken += 1
            self._picture = picture
            self._fresh.notify_all()


def _exposed(video: cv2.VideoCapture) -> float:
    """When a camera took its last picture, in the time of `time.monotonic`.

    Video4Linux states it in that clock; other drivers, or clocks, do not: now then.
    """
    import cv2

    now, stated = time.monotonic(), 1e-3 * float(video.get(cv2.CAP_PROP_POS_MSEC))
    return stated if 0.0 <= now - stated < _STATED_S else now


def first_pictures(
    names: Sequence[str],
    settings: CameraSettings = CameraSettings(),
) -> list[UInt8[Array, "H W 3"]]:
    """What cameras or the beginnings of video files show now, RGB.

    Raises InputError for one that cannot be opened or has no picture.
    """
    import cv2

    found = []
    for name in names:
        video = _opened(name, settings)
        there, image = video.read()
        video.release()
        if not there:
            raise InputError(f"no picture in '{name}'", valid="a video file or a camera's number")
        found.append(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    return found


def list_cameras(devices: Path = _DEVICES) -> list[CameraEntry]:
    """Cameras of this machine that OpenCV can open, and those that are in use."""
    import cv2

    listed = {int(path.name[5:]): path / "name" for path in devices.glob("video*")
              if path.name[5:].isdigit()}  # fmt: skip
    found = []
    for number in sorted(listed) if devices.is_dir() else range(_TRIED):
        video = _captured(number)
        there, image = video.read() if video.isOpened() else (False, None)
        name = listed[number].read_text().strip() if number in listed else f"camera {number}"
        if there and image is not None:
            size = image.shape[1], image.shape[0]
            found.append(CameraEntry(number, name, size, float(video.get(cv2.CAP_PROP_FPS))))
        elif number in listed:
            found.append(CameraEntry(number, name, None, 0.0))
        video.release()
    return found


def _captured(name: int | str) -> cv2.VideoCapture:
    """OpenCV's capture, open or not, without its warnings on stderr."""
    import cv2

    messages = cv2.utils.logging
    before = messages.setLogLevel(messages.LOG_LEVEL_SILENT)
    try:
        return cv2.VideoCapture(name)
    finally:
        messages.setLogLevel(before)


def _opened(name: str, settings: CameraSettings) -> cv2.VideoCapture:
    video = _captured(int(name) if name.isdigit() else name)
    if not video.isOpened():
        raise InputError(f"cannot open '{name}'",
                         valid="a video file, or a number of egocap live --list")  # fmt: skip
    if name.isdigit():
        _adjust(video, name, settings)
    return video


def _adjust(video: cv2.VideoCapture, name: str, settings: CameraSettings) -> None:
    """Set up a camera. Raises InputError for a size or an exposure that it does not take."""
    import cv2

    if settings.size is not None:
        properties = cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT
        for which, value in zip(properties, settings.size, strict=True):
            video.set(which, value)
        taken = tuple(int(video.get(which)) for which in properties)
        if taken != settings.size:
            raise InputError(
                f"camera {name} gives no pictures of {settings.size}", valid=f"{taken}"
            )
    if settings.fps is not None:
        video.set(cv2.CAP_PROP_FPS, settings.fps)
    if settings.exposure is not None:
        video.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
        if not video.set(cv2.CAP_PROP_EXPOSURE, settings.exposure):
            raise InputError(f"camera {name} takes no exposure of {settings.exposure:g}",
                             valid="its driver's range, or automatic exposure")  # fmt: skip
