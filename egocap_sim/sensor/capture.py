"""Simulate the capture of a frame: render sub-frames, average them, and apply the faults."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.cameras.rig import Rig
from egocap.data.truth import BLACK
from egocap_sim.core.rng import make_rng
from egocap_sim.render.views import Views
from egocap_sim.sensor import optics, sensor_kernel
from egocap_sim.sensor.light import DECODING, compress, lamp_phase, lamp_rows, vignette
from egocap_sim.sensor.plan import SensorPlan
from egocap_sim.sensor.timing import exposure, instants

STILL_M = 0.01  # the shadow map is reused for smaller body motion
MANY = 4  # sub-frames from which on each is drawn at lower sharpness


class JointTest(Protocol):
    """Visibility of joints in the wanted views just drawn, which must be complete."""

    def __call__(self, wanted: Collection[int]) -> UInt8[Array, "V 18"]: ...


class Draw(Protocol):
    """Render rows of some views of a frame's world at a time in seconds.

    The shadow map may be reused if nothing moved by `still_m` metres. `coarsely` lowers the
    sharpness, for many averaged sub-frames.
    """

    def __call__(
        self, index: int, time: float, rows: Mapping[int, slice], still_m: float, coarsely: bool
    ) -> tuple[Views, JointTest]: ...


@dataclass(frozen=True, eq=False)
class CapturedFrame:
    """The recorded data of one frame, one value per view. Planes not requested are empty."""

    images: tuple[UInt8[Array, "H W 3"], ...]
    parts: tuple[UInt8[Array, "H W"], ...]
    depth: tuple[Float[Array, "H W"], ...]
    visibility: UInt8[Array, "V 18"]


class SensorSimulator:
    """Capture the frames of a plan; the result does not depend on their order."""

    def __init__(self, rig: Rig, plan: SensorPlan, draw: Draw, *, parts: bool, depth: bool) -> None:
        self._rig, self._plan, self._draw = rig, plan, draw
        self._parts, self._depth = parts, depth
        sensor = plan.sensor
        self._vignette = [vignette(m.camera, sensor.vignetting, sensor.rim) for m in rig.mounts]
        self._encoding = sensor_kernel.encoding_table(sensor.gamma, sensor.tone)
        self._noise = sensor_kernel.noise_table()
        self._last: dict[int, tuple[int, UInt8[Array, "H W 3"]]] = {}  # view: frame and picture

    def capture(self, index: int) -> CapturedFrame:
        """Render and record one frame."""
        light, frame = self._expose(index)
        for v, view_light in enumerate(light):
            if self._plan.applied.source[index, v] == index:
                self._last[v] = index, self._develop(view_light, index, v)
        images = tuple(self._displayed(index, v) for v in range(len(light)))
        return CapturedFrame(images, frame.parts, frame.depth, frame.visibility)

    def _displayed(self, index: int, v: int) -> UInt8[Array, "H W 3"]:
        source = int(self._plan.applied.source[index, v])
        camera = self._rig.cameras[v]
        if source == BLACK:
            return np.zeros((camera.height, camera.width, 3), np.uint8)
        if self._last.get(v, (None,))[0] != source:
            self._last[v] = source, self._develop(self._expose(source)[0][v], source, v)
        return self._last[v][1]

    def _expose(self, index: int) -> tuple[list[Float[Array, "H W 3"]], CapturedFrame]:
        """Linear light of each view, planes at each row's time, visibility at the middle time.

        A sub-frame is drawn only in the rows exposed then, except the one nearest to the middle of
        a view's exposure, which is drawn completely to test visibility.
        """
        sensor, applied = self._plan.sensor, self._plan.applied
        timing = sensor.shutter_s, sensor.readout_s
        middle = applied.time[index]
        rendered = instants(middle, *timing, int(applied.subframes[index]))
        exposures = [exposure(t, camera.height, *timing, rendered)
                     for t, camera in zip(middle, self._rig.cameras, strict=True)]  # fmt: skip
        reference = np.abs(middle[:, None] - rendered.times).argmin(1)
        coarsely = bool(applied.subframes[index] >= MANY)
        sizes = [(c.height, c.width) for c in self._rig.cameras]
        light = [np.zeros((*size, 3), np.float32) for size in sizes]
        parts = [np.zeros(size, np.uint8) for size in sizes] if self._parts else []
        depth = [np.zeros(size, np.float32) for size in sizes] if self._depth else []
        visibility = np.zeros((len(sizes), len(LABELS)), np.uint8)
        for i, time in enumerate(rendered.times):
            whole = np.flatnonzero(reference == i)
            rows = {v: slice(0, sizes[v][0]) if v in whole else e.rows(i)
                    for v, e in enumerate(exposures)}  # fmt: skip
            rows = {v: band for v, band in rows.items() if band.stop > band.start}
            if not rows:
                continue
            still_m = STILL_M if i else 0.0
            views, find_visible = self._draw(index, float(time), rows, still_m, coarsely)
            for v, band in rows.items():
                weight = exposures[v].weights[band, i]
                sensor_kernel.add_light(light[v][band], views.images[v], weight, DECODING)
                own = np.flatnonzero(exposures[v].nearest == i)  # contiguous, possibly empty
                if len(own):
                    band = slice(int(own[0]), int(own[-1]) + 1)
                    if self._parts:
                        parts[v][band] = views.part_rows(v, band)
                    if self._depth:
                        depth[v][band] = views.depth_rows(v, band)
            if len(whole):
                visibility[whole] = find_visible(whole)[whole]
        return light, CapturedFrame((), tuple(parts), tuple(depth), visibility)

    def _develop(self, light: Float[Array, "H W 3"], index: int, v: int) -> UInt8[Array, "H W 3"]:
        """The sensor's image of the light."""
        sensor = self._plan.sensor
        light = self._through_lens(light, v)
        if sensor.flicker:  # the mean over the rows is part of the exposure
            phase = lamp_phase(make_rng(self._plan.seed, "sensor.flicker"))
            rows = lamp_rows(self._plan.applied.time[index, v], len(light), sensor, phase)
            light = light * (rows / max(rows.mean(), 1e-3)).astype(np.float32)[:, None, None]
        rng = make_rng(self._plan.seed, f"sensor.noise.{self._rig.views[v]}.{index}")
        height, width, _ = light.shape
        start = rng.integers(0, sensor_kernel.NOISE_SAMPLES - 3 * width, height)
        image = sensor_kernel.develop(
            light, 2.0 ** float(self._plan.applied.exposure_ev[index, v]), self._vignette[v],
            1.0 / sensor.full_well_e if sensor.full_well_e else 0.0, sensor.read_noise**2,
            self._noise, start, self._encoding,
        )  # fmt: skip
        if sensor.saturation != 1.0:
            image = optics.saturated(image, sensor.saturation)
        return compress(image, sensor.jpeg_quality) if sensor.jpeg_quality else image

    def _through_lens(self, light: Float[Array, "H W 3"], v: int) -> Float[Array, "H W 3"]:
        """Light with the faults of the lens and of the white balance."""
        sensor = self._plan.sensor
        if sensor.glare:
            light = optics.glare(light, sensor.glare)
        if sensor.aberration:
            light = optics.aberrated(light, self._rig.cameras[v], sensor.aberration)
        if sensor.warmth_ev:
            light = light * optics.balance_gains(sensor.warmth_ev)
        return light
