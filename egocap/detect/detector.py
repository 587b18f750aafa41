"""The learned detector: images of a rig's cameras in, detections of body parts out.

Images are resampled to the canonical view and run through the network in one batch; its output is
mapped back to the cameras' pixels. Views are independent of each other.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from collections.abc import Sequence as Row
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int64, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.sequence import Sequence
from egocap.detect.calibration import present
from egocap.detect.canonical_view import CanonicalView
from egocap.detect.engine import Engine, EngineName, Outputs, open_engine
from egocap.detect.heatmaps import modes
from egocap.detect.input_images import ahead, as_rgb, recorded_pictures
from egocap.detect.view_times import at_frame_times
from egocap.detect.weights import Weights, open_weights
from egocap.errors import InputError

log = logging.getLogger(__name__)

MODES = 3
"""Modes kept per label."""

Slots = Int64[Array, "B 2"]  # frame within the batch, and view, of every image


class Detector:
    """The detector for the images of a rig.

    Args:
        rig: the cameras.
        weights: a file of weights, or opened ones; the shipped ones when None.
        engine: one of `engine.EngineName`, or an open engine.
        threads: of the network; all cores when None.
        streams: frames that `detect` runs the network on at once, sharing the threads; one a thread
            when None. With 1 the network has all threads for a frame: the lowest latency.

    Raises:
        FileError: the weights are missing or damaged.
        MachineError: the engine is not installed.
    """

    def __init__(
        self,
        rig: Rig,
        weights: Weights | str | Path | None = None,
        engine: EngineName | Engine = "auto",
        threads: int | None = None,
        streams: int | None = None,
    ) -> None:
        self.rig = rig
        self.weights = weights if isinstance(weights, Weights) else open_weights(weights)
        if not isinstance(engine, Engine):
            engine = open_engine(
                self.weights, engine, threads, streams=streams, batch=len(rig.mounts)
            )
        self.engine = engine
        self._views = tuple(CanonicalView(m, self.weights.view) for m in rig.mounts)
        self._resized: dict[tuple[int, int, int], CanonicalView] = {}
        self._shape = (self.weights.view.height, self.weights.view.width, 3)

    @property
    def source(self) -> str:
        """The `source` of its detections."""
        return f"learned:{self.weights.name}"

    def detect(
        self,
        sequence: Sequence,
        *,
        frames: int | None = None,
        batch: int | None = None,
        on_frames: Callable[[int], None] = lambda count: None,
    ) -> Detections:
        """Detections in the first `frames` of a sequence (all when None).

        Threads read and resample the next images while the network runs. Views without an image
        are skipped; a warning counts frames without detections. Truth is not read.

        Args:
            sequence: recorded with this rig.
            frames: how many, from the first.
            batch: frames per run of the network; 16 on a GPU, else 1, when None.
            on_frames: called with the number of frames just finished.

        Raises:
            FileError: an image is damaged.
            InputError: too few or too many frames, or images that do not fit the rig.
        """
        count = len(sequence) if frames is None else frames
        if not 1 <= count <= len(sequence):
            raise InputError(f"{count} frames of {sequence.folder}", valid=f"1 to {len(sequence)}")
        found = self.detect_rows(sequence, range(count), batch, on_frames)
        if sequence.frame_times is not None:
            found = at_frame_times(found, sequence.frame_times[:count], self.rig)
        for name, missing in zip(sequence.rig.views, missing_pictures(found), strict=True):
            if missing:
                log.warning("view '%s' has no detections in %d of %d frames", name, missing, count)
        return found

    def detect_rows(
        self,
        sequence: Sequence,
        rows: range,
        batch: int | None = None,
        on_frames: Callable[[int], None] = lambda count: None,
    ) -> Detections:
        """Detections in some frames, of the moments at which their pictures were taken.

        `detect` also moves them to the frames' times and warns of views without any. Arguments and
        errors are those of `detect`; `rows` are frames of the sequence.
        """
        batch = batch or (16 if self.engine.name == "cuda" else 1)

        def prepared(some: range) -> tuple[range, Array, Slots]:
            return some, *self.canonical([recorded_pictures(sequence, i) for i in some])

        def detected(job: tuple[range, Array, Slots]) -> Detections:
            some, views, slots = job
            return self.read(self.run(views), slots, sequence.times[some.start : some.stop])

        parts, streams = [], self.engine.streams
        jobs = (rows[i : i + batch] for i in range(0, len(rows), batch))
        for part in ahead(ahead(jobs, prepared, 2 * streams), detected, streams, streams):
            parts.append(part)
            on_frames(len(part.times))
        return joined(parts)

    def detect_images(self, images: Row[Array | None], time: float = 0.0) -> Detections:
        """Detections (T = 1) in the images of one instant, one per view, None where missing.

        Images may be grey or have 16 bits, and any size with the aspect ratio of the rig's; points
        are in pixels of the rig's image size. Raises InputError for other images, or their number.
        """
        views, slots = self.canonical([images])
        return self.read(self.run(views), slots, np.array([time]))

    def canonical(self, pictures: Row[Row[Array | None]]) -> tuple[UInt8[Array, "B H W 3"], Slots]:
        """Canonical views of the images of T instants, and their slots. Raises InputError."""
        found: list[Array] = []
        slots: list[tuple[int, int]] = []
        for t, images in enumerate(pictures):
            if len(images) != len(self._views):
                raise InputError(f"{len(images)} pictures of a rig of {len(self._views)} views")
            for v, image in enumerate(images):
                if image is not None:
                    found.append(self._view_of(v, as_rgb(image)))
                    slots.append((t, v))
        if not found:
            return np.zeros((0, *self._shape), np.uint8), np.zeros((0, 2), np.int64)
        return np.stack(found), np.array(slots)

    def run(self, views: UInt8[Array, "B H W 3"]) -> Outputs:
        """Output of the network for canonical views."""
        if len(views):
            return self.engine.run(views)
        h, w = (n // self.weights.stride for n in self._shape[:2])
        labels = len(LABELS)
        return np.zeros((0, labels, h, w), np.float32), np.zeros((0, labels, 4), np.float32)

    def read(self, outputs: Outputs, slots: Slots, times: Float[Array, "T"]) -> Detections:
        """Decode the network's output of every slot into detections in the rig's pixels."""
        heat, info = outputs
        found = no_detections(times, len(self._views), self.source)
        if not len(slots):
            return found
        places = modes(heat, self.weights.stride, MODES)
        for v, view in enumerate(self._views):
            rows = np.flatnonzero(slots[:, 1] == v)
            if len(rows):
                self._read_view(
                    found, view, v, slots[rows, 0],
                    *(view.labels(a[rows], 1) for a in (places.points, places.weight, info)),
                )  # fmt: skip
        return found

    def _read_view(
        self, found: Detections, view: CanonicalView, v: int, at: Int64[Array, "n"],
        points: Float[Array, "n 18 K 2"], weight: Float[Array, "n 18 K"],
        info: Float[Array, "n 18 4"],
    ) -> None:  # fmt: skip
        """Write one view's detections into the arrays of `found`."""
        camera = self.rig.cameras[v]
        assert found.modes is not None and found.mode_weights is not None
        pixels, seen = view.to_camera(points)
        seen &= ((pixels >= -0.5) & (pixels <= (camera.width - 0.5, camera.height - 0.5))).all(-1)
        valid = present(info) & seen[..., 0]
        calibration = self.weights.calibration
        sigma = calibration.sigma(info) * view.magnification(points[:, :, 0])
        usable = seen & valid[..., None]
        found.points[at, v] = np.where(valid[..., None], pixels[:, :, 0], np.nan)
        found.sigma[at, v] = np.where(valid, sigma, np.nan)
        found.confidence[at, v] = np.where(valid, calibration.confidence(info), 0.0)
        found.valid[at, v] = valid
        found.modes[at, v] = np.where(usable[..., None], pixels, np.nan)
        found.mode_weights[at, v] = np.where(usable, weight, 0.0)

    def _view_of(self, v: int, image: UInt8[Array, "h w 3"]) -> UInt8[Array, "H W 3"]:
        height, width = image.shape[:2]
        mount = self.rig.mounts[v]
        camera = mount.camera
        if (width, height) == (camera.width, camera.height):
            return self._views[v].image(image)
        key = (v, width, height)
        if key not in self._resized:
            # One pixel of deviation in the aspect ratio is rounding.
            off = abs(width * camera.height - height * camera.width)
            if off > max(camera.width, camera.height):
                raise InputError(
                    f"a picture of {width} x {height} for the view '{mount.name}'",
                    valid=f"the aspect ratio of {camera.width} x {camera.height}",
                )
            resized = replace(mount, camera=camera.resized(width, height))
            self._resized[key] = CanonicalView(resized, self.weights.view)
        return self._resized[key].image(image)


def missing_pictures(found: Detections) -> list[int]:
    """Number of frames without any detection, for each view."""
    return [int(n) for n in np.count_nonzero(~found.valid.any(-1), axis=0)]


def no_detections(times: Float[Array, "T"], views: int, source: str) -> Detections:
    """Detections of T frames, all missing."""
    shape = (len(times), views, len(LABELS))
    return Detections(
        times=np.asarray(times, float),
        points=np.full((*shape, 2), np.nan),
        sigma=np.full(shape, np.nan),
        confidence=np.zeros(shape),
        valid=np.zeros(shape, bool),
        source=source,
        modes=np.full((*shape, MODES, 2), np.nan),
        mode_weights=np.zeros((*shape, MODES)),
    )


def joined(parts: Row[Detections]) -> Detections:
    """Concatenate detections of consecutive frames from one source."""
    names = [f.name for f in fields(Detections) if f.name != "source"]
    arrays: dict[str, Any] = {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}
    return Detections(**arrays, source=parts[0].source)
