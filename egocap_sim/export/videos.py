"""Export to ordinary camera files: one H.264 video of every view, and no truth.

Each camera starts at its own time, has its own white balance and exposure, loses a few frames and
repeats some, records sound, and states the times of its own clock. Clocks that differ between
frames are rendered: the scene's `fps`, `time_offset_s` and `clock_drift_ppm`. planted.json holds
what was done, for scoring only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from egocap.data.sequence import Sequence
from egocap.errors import InputError
from egocap.files import replacing, write_json
from egocap_sim.core.rng import make_rng
from egocap_sim.export.formats import new_folder
from egocap_sim.export.sound import RATE, SceneSound, scene_sound
from egocap_sim.sensor.light import DECODING

if TYPE_CHECKING:
    from av.video.stream import VideoStream

PLANTED = "planted.json"
BITS_PER_PIXEL = 0.25  # of a phone: 17 Mbit/s for 1920 x 1080 at 30 Hz
LATEST_START_S = 1.5
LOST, REPEATED = 3, 1  # frames of each view, if it has a hundred
EXPOSURE_EV, BALANCE_EV = 0.3, 0.15  # standard deviations
_TICKS = 90_000  # a second, of the container's clock
_BLOCK = 1024  # samples of a block of sound


@dataclass(frozen=True, eq=False)
class CameraFile:
    """What a camera does to its view of a sequence."""

    frames: tuple[int, ...]  # of the sequence, written; one twice in a row: repeated
    places: tuple[int, ...]  # index of each by the camera's own clock
    gain: Float[Array, "3"]  # of the linear light of red, green and blue


def write_videos(sequence: Sequence, out: Path, on_frames: Callable[[int], None]) -> None:
    """Write VIEW.mp4 of every view, rig.json and planted.json into a new folder.

    Raises InputError for images with an odd side and for fewer than ten frames.
    """
    manifest = sequence.manifest
    if len(sequence) < 10:
        raise InputError(f"{len(sequence)} frames are too few for camera files", valid="10 or more")
    for camera in sequence.rig.cameras:
        if camera.width % 2 or camera.height % 2:
            raise InputError(f"images of {camera.width} x {camera.height}",
                             valid="even width and height, for H.264")  # fmt: skip
    new_folder(out)
    planned = [_plan(sequence, v) for v in range(len(manifest.views))]
    sound = scene_sound(sequence)
    with ExitStack() as stack:
        writers = [
            stack.enter_context(_Writer(out / f"{view}.mp4", sequence, v, planned[v], sound))
            for v, view in enumerate(manifest.views)
        ]
        for frame in sequence:
            for writer, image in zip(writers, frame.images, strict=True):
                writer.add(frame.index, image)
            on_frames(1)
    write_json(out / "rig.json", sequence.rig.to_dict())
    write_json(out / PLANTED, planted(sequence, planned))


def planted(sequence: Sequence, cameras: list[CameraFile]) -> dict[str, Any]:
    """What was done to every view; clocks relative to that of the first view's file.

    Common time = offset_s + (1 + drift_ppm / 10^6) x own time. `places` are the indices of the
    pictures by the camera's own clock and `frames` those of the sequence that they show; `lost` and
    `repeated` are places.
    """
    clocks = [_clock(sequence, v, camera) for v, camera in enumerate(cameras)]
    start, rate = clocks[0]
    return {
        "sequence": sequence.manifest.name,
        "fps": sequence.manifest.fps,
        "views": {
            view: {
                "offset_s": (own_start - start) / rate,
                "drift_ppm": 1e6 * (own_rate / rate - 1.0),
                "gain": camera.gain.tolist(),
                "lost": sorted(set(range(camera.places[-1] + 1)) - set(camera.places)),
                "repeated": [
                    place for place, shown, before
                    in zip(camera.places[1:], camera.frames[1:], camera.frames[:-1], strict=True)
                    if shown == before
                ],
                "places": list(camera.places),
                "frames": list(camera.frames),
            }
            for view, camera, (own_start, own_rate)
            in zip(sequence.manifest.views, cameras, clocks, strict=True)
        },
    }  # fmt: skip


def _clock(sequence: Sequence, v: int, camera: CameraFile) -> tuple[float, float]:
    """Time of the scene at the file's time zero, and seconds of the scene a second of the file."""
    taken = sequence.times if sequence.sensor is None else sequence.sensor.time[:, v]
    rate, zero = np.polyfit(sequence.times, taken, 1)
    return float(zero + rate * camera.frames[0] / sequence.manifest.fps), float(rate)


def _plan(sequence: Sequence, v: int) -> CameraFile:
    """Draw start, lost and repeated frames, exposure and white balance of a view."""
    manifest = sequence.manifest
    rng = make_rng(manifest.seed, f"videos.{manifest.views[v]}")
    count = len(sequence)
    start = int(rng.integers(0, int(min(LATEST_START_S * manifest.fps, 0.2 * count))))
    if sequence.sensor is None:
        alone = np.ones(count, bool)
    else:
        alone = ~sequence.sensor.dropped[:, v]
    inner = np.flatnonzero(alone[start + 2 : -2]) + start + 2
    many = np.maximum(1, np.rint(np.array([LOST, REPEATED]) * min(1.0, count / 100))).astype(int)
    if len(inner) < many.sum():
        raise InputError(f"{len(inner)} frames of the view '{manifest.views[v]}' were not dropped",
                         valid=f"{many.sum()} or more")  # fmt: skip
    chosen = rng.choice(inner, many.sum(), replace=False)
    lost, again = set(chosen[: many[0]].tolist()), set(chosen[many[0] :].tolist())
    places = [i for i in range(start, count) if i not in lost]
    frames = []
    for i in places:
        frames.append(frames[-1] if i in again else i)
    balance = rng.normal(0.0, BALANCE_EV, 3)
    balance -= balance[1]
    gain = 2.0 ** (rng.normal(0.0, EXPOSURE_EV) + balance)
    return CameraFile(tuple(frames), tuple(i - start for i in places), gain)


def _recorded_sound(
    sequence: Sequence, v: int, camera: CameraFile, sound: SceneSound
) -> Float32[Array, "N"]:
    """What the microphone of a view records from its first to its last picture."""
    start, rate = _clock(sequence, v, camera)
    own = np.arange(int(camera.places[-1] / sequence.manifest.fps * RATE)) / RATE
    rng = make_rng(sequence.manifest.seed, f"microphone.{sequence.manifest.views[v]}")
    return sound.recorded(start + rate * own, float(rng.uniform(0.3, 1.0)), rng)


class _Writer:
    """Encodes one view."""

    def __init__(
        self, path: Path, sequence: Sequence, v: int, camera: CameraFile, sound: SceneSound
    ) -> None:
        self._path, self._camera = path, camera
        self._heard = _recorded_sound(sequence, v, camera, sound)
        self._fps = Fraction(sequence.manifest.fps).limit_denominator(1001)
        self._size = sequence.rig.cameras[v].width, sequence.rig.cameras[v].height
        self._table = np.clip(
            np.rint(255.0 * np.sqrt(DECODING[:, None] * camera.gain)), 0, 255
        ).astype(np.uint8)  # fmt: skip
        self._wanted: dict[int, list[int]] = {}
        for frame, place in zip(camera.frames, camera.places, strict=True):
            self._wanted.setdefault(frame, []).append(place)
        self._stack, self._written = ExitStack(), 0

    def __enter__(self) -> _Writer:
        import av

        part = self._stack.enter_context(replacing(self._path, keep_suffix=True))
        self._container = self._stack.enter_context(av.open(str(part), "w"))
        stream: VideoStream = self._container.add_stream(  # pyright: ignore[reportAssignmentType]
            "libx264", rate=self._fps, options={"preset": "fast", "threads": "1"}
        )
        width, height = self._size
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.bit_rate = int(BITS_PER_PIXEL * width * height * float(self._fps))
        stream.codec_context.time_base = Fraction(1, _TICKS)
        self._stream = stream
        self._sound = self._container.add_stream("aac", rate=RATE, layout="mono")
        return self

    def __exit__(self, *exception: Any) -> None:
        if exception[0] is None:
            self._add_sound(len(self._heard))
            self._container.mux(self._sound.encode(None))  # pyright: ignore[reportArgumentType]
            self._container.mux(self._stream.encode())
        self._stack.__exit__(*exception)

    def add(self, index: int, image: UInt8[Array, "H W 3"]) -> None:
        """Encode a frame of the sequence as often as the camera records it."""
        for frame in self._frames(index, image):
            self._add_sound(round(frame.pts * RATE / _TICKS))
            self._container.mux(self._stream.encode(frame))

    def _add_sound(self, until: int) -> None:
        """Encode the sound up to a sample."""
        from av import AudioFrame

        while self._written < min(until, len(self._heard)):
            block = self._heard[self._written : self._written + _BLOCK]
            frame = AudioFrame.from_ndarray(block[None], format="fltp", layout="mono")
            frame.sample_rate, frame.pts = RATE, self._written
            frame.time_base = Fraction(1, RATE)
            self._container.mux(self._sound.encode(frame))  # pyright: ignore[reportArgumentType]
            self._written += len(block)

    def _frames(self, index: int, image: UInt8[Array, "H W 3"]) -> Iterator[Any]:
        import cv2
        from av import VideoFrame

        places = self._wanted.get(index, [])
        for place in places:
            picture = cv2.LUT(np.ascontiguousarray(image), self._table[None]).astype(np.uint8)
            frame = VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            frame.pts = round(place / self._fps * _TICKS)
            frame.time_base = Fraction(1, _TICKS)
            yield frame
