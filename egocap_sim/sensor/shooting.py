"""One frame through the sensor: sub-frames rendered, put together, and spoilt as asked."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.labels import LABELS
from egocap.rig import Rig
from egocap.sequence import BLACK
from egocap_sim.render.views import Views
from egocap_sim.sensor.film import Film
from egocap_sim.sensor.light import compress, encode, expose, noisy, vignette
from egocap_sim.sensor.timing import Exposure, add_rows, add_subframe, exposure
from egocap_sim.streams import stream

See = Callable[[], UInt8[Array, "V 18"]]
"""Tells which joints the views just drawn see."""
Draw = Callable[[int, float, Collection[int]], tuple[Views, See]]
"""Renders some views of a frame's world at a time in seconds."""


@dataclass(frozen=True, eq=False)
class Shot:
    """What is recorded of one frame, each a value a view. Planes not asked for are empty."""

    images: tuple[UInt8[Array, "H W 3"], ...]
    parts: tuple[UInt8[Array, "H W"], ...]
    depth: tuple[Float[Array, "H W"], ...]
    visibility: UInt8[Array, "V 18"]


class Shooter:
    """Takes a film's frames. Frames may be taken in any order; each comes out the same."""

    def __init__(self, rig: Rig, film: Film, draw: Draw, *, parts: bool, depth: bool) -> None:
        self._rig, self._film, self._draw = rig, film, draw
        self._parts, self._depth = parts, depth
        strength = film.sensor.vignetting
        self._vignette = [vignette(m.camera, strength)[..., None] if strength else None
                          for m in rig.mounts]  # fmt: skip
        self._last: dict[int, tuple[int, UInt8[Array, "H W 3"]]] = {}  # view: frame and picture

    def shoot(self, index: int) -> Shot:
        """Render and record one frame."""
        light, shot = self._expose(index)
        for v, view_light in enumerate(light):
            if self._film.applied.source[index, v] == index:
                self._last[v] = index, self._develop(view_light, index, v)
        images = tuple(self._shown(index, v) for v in range(len(light)))
        return Shot(images, shot.parts, shot.depth, shot.visibility)

    def _shown(self, index: int, v: int) -> UInt8[Array, "H W 3"]:
        source = int(self._film.applied.source[index, v])
        camera = self._rig.cameras[v]
        if source == BLACK:
            return np.zeros((camera.height, camera.width, 3), np.uint8)
        if self._last.get(v, (None,))[0] != source:
            self._last[v] = source, self._develop(self._expose(source)[0][v], source, v)
        return self._last[v][1]

    def _expose(self, index: int) -> tuple[list[Float[Array, "H W 3"]], Shot]:
        """Linear light of each view, and planes and visibility at the times they were exposed."""
        sensor, applied = self._film.sensor, self._film.applied
        exposures: list[Exposure] = [
            exposure(t, camera.height, sensor.shutter_s, sensor.readout_s,
                     int(applied.subframes[index]))
            for t, camera in zip(applied.time[index], self._rig.cameras, strict=True)
        ]  # fmt: skip
        sizes = [(c.height, c.width) for c in self._rig.cameras]
        light = [np.zeros((*size, 3), np.float32) for size in sizes]
        parts = [np.zeros(size, np.uint8) for size in sizes] if self._parts else []
        depth = [np.zeros(size, np.float32) for size in sizes] if self._depth else []
        visibility = np.zeros((len(sizes), len(LABELS)), np.uint8)
        for time in np.unique(np.concatenate([e.times for e in exposures])):
            wanted = {
                v: i for v, e in enumerate(exposures) for i in np.flatnonzero(e.times == time)
            }
            views, see = self._draw(index, float(time), wanted)
            drawn_parts = views.parts() if self._parts else ()
            drawn_depth = views.depth() if self._depth else ()
            for v, i in wanted.items():
                exposed = exposures[v]
                add_subframe(light[v], views.images[v], exposed.weights[:, i])
                rows = exposed.nearest == i
                for plane, drawn in ((parts, drawn_parts), (depth, drawn_depth)):
                    if plane:
                        add_rows(plane[v], drawn[v], rows)
                owner = np.abs(applied.joint_time[index, v, :, None] - exposed.times).argmin(1)
                if (owner == i).any():
                    visibility[v, owner == i] = see()[v, owner == i]
        return light, Shot((), tuple(parts), tuple(depth), visibility)

    def _develop(self, light: Float[Array, "H W 3"], index: int, v: int) -> UInt8[Array, "H W 3"]:
        """The picture a sensor makes of the light."""
        sensor = self._film.sensor
        if stops := float(self._film.applied.exposure_ev[index, v]):
            light = expose(light, stops)
        if (fall_off := self._vignette[v]) is not None:
            light = light * fall_off
        if sensor.full_well_e is not None or sensor.read_noise:
            rng = stream(self._film.seed, f"sensor.noise.{self._rig.views[v]}.{index}")
            light = noisy(light, sensor.full_well_e, sensor.read_noise, rng)
        image = encode(light, sensor.gamma)
        return image if sensor.jpeg_quality is None else compress(image, sensor.jpeg_quality)
