"""A body, the rays of a rig and settings, ready to evaluate poses against images, fast.

`ImageModel` is the compiled form of `egocap.image_model.torch_energy`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.errors import InputError
from egocap.image_model.body_kernel import make_chain
from egocap.image_model.colour_measure import ColourMeasure
from egocap.image_model.image_kernel import image_energy, image_visibility
from egocap.image_model.image_rays import ImageRays, ray_colours
from egocap.image_model.kernel_arrays import (
    MAX_EDGES,
    Palettes,
    RayColours,
    Request,
    Settings,
    gaussian_arrays,
    make_memory,
    make_scratch,
    ray_arrays,
)

_ALL = np.zeros(0, np.int32)
_NO_FEATURES, _NO_TABLE = np.zeros((1, 3), np.float32), np.zeros((1, 1), np.float32)
_NO_BINS = np.zeros(0, np.int32)
_NO_WEIGHTS = np.zeros(0, np.float32)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Energy of a pose and its derivatives."""

    energy: float
    gradient: Float[Array, "37"]  # per radian
    curvature: Float[Array, "37 37"] | None = None  # Gauss-Newton, per rad^2


class ImageModel:
    """The body, the rays and the settings, ready to evaluate poses against images.

    `cell` [m] is the length of the cells of `visibility.cell_visibility`, `far` [m] how far they
    go; a Gaussian is left out of a ray that it would dim by less than the optical depth `cutoff`.
    `threads` is the number of processor cores to use, all by default; on a busy machine one is
    faster. Raises InputError for settings out of range. Not to be shared between Python threads.
    """

    def __init__(
        self,
        body: GaussianBody,
        rays: ImageRays,
        cell: float = 0.02,
        far: float = 2.6,
        cutoff: float = 2e-3,
        measure: ColourMeasure = ColourMeasure(),  # noqa: B008 (frozen)
        threads: int | None = None,
    ) -> None:
        if not (0.001 <= cell <= 0.2 and cell < far <= 100.0 and far / cell <= 10_000):
            raise InputError(
                f"cells of {cell} m up to {far} m", valid="0.001 to 0.2 m, 10000 cells"
            )
        most = numba.config.NUMBA_NUM_THREADS  # pyright: ignore[reportPrivateImportUsage, reportAttributeAccessIssue]
        if threads is not None and not 1 <= threads <= most:
            raise InputError(f"{threads} threads", valid=f"1 to {most}")
        if not 0.0 < cutoff < 1.0:
            raise InputError(f"a cutoff of {cutoff}", valid="between 0 and 1")
        self.body, self.rays = body, rays
        self.cell, self.far, self.cutoff, self.measure = cell, far, cutoff, measure
        in_cone, count, cells = measure.kind == "cone", len(body.parts), round(far / cell)
        scale = 1.0 / measure.reach**2 if in_cone else 2.0 / measure.reach
        self._settings = Settings(np.float32(cell), cells, in_cone, np.float32(scale))
        self._threads = threads or numba.get_num_threads()
        self._body = make_chain(body), gaussian_arrays(body, cell, cutoff, measure)
        self._rays = ray_arrays(rays)
        self._scratch = make_scratch(self._threads, count, cells)
        self._memory = make_memory(self._threads, len(rays), len(rays.tile_view), count, MAX_EDGES)

    def colours(self, images: Sequence[UInt8[Array, "H W 3"]]) -> Float32[Array, "P 3"]:
        """Colours of RGB images along the rays, as `evaluate` takes them."""
        hsv = ray_colours(self.rays, images)
        return np.ascontiguousarray(self.measure.features(hsv), np.float32)

    def evaluate(
        self,
        angles: Float[Array, "37"],
        colours: Float32[Array, "P 3"] | Palettes,
        *,
        curvature: bool = False,
        selected: Int32[Array, "S"] = _ALL,
        weights: Float32[Array, "S"] = _NO_WEIGHTS,
        keep: float = 1.0,
        seed: int = 0,
    ) -> Evaluation:
        """Energy of a pose (equations 5, 6), gradient and, if asked, Gauss-Newton matrix.

        `colours` are those of `self.colours`, or the bins of a `palette.Palette`. With `selected`,
        only these rays count, each times its weight. With `keep` < 1 each Gaussian's derivative is
        left out of each ray at random, and those kept count 1 / keep times: the gradient's
        expectation stays.
        """
        if isinstance(colours, Palettes):
            assert colours.bins.shape == (len(self.rays),), colours.bins.shape
            assert len(colours.unlike) == len(self.body.parts), colours.unlike.shape
            given = RayColours(_NO_FEATURES, *colours)
        else:
            assert colours.shape == (len(self.rays), 3), colours.shape
            assert colours.dtype == np.float32, colours.dtype
            given = RayColours(colours, _NO_BINS, _NO_TABLE)
        request = Request(selected, weights, np.float32(keep), np.uint64(seed), bool(curvature))
        numba.set_num_threads(self._threads)
        energy, gradient, matrix = image_energy(
            np.asarray(angles, np.float64), given, *self._body, self._rays, self._settings,
            request, self._scratch, self._memory,
        )  # fmt: skip
        return Evaluation(energy, gradient, matrix if curvature else None)

    def pixel_energies(
        self, angles: Float[Array, "37"], colours: Float32[Array, "P 3"] | Palettes
    ) -> tuple[Float32[Array, "P"], Float32[Array, "P"]]:
        """Energy of every ray; length of its derivative by the Gaussians' centres, per metre."""
        self.evaluate(angles, colours)
        return self._memory.pixels[0].copy(), self._memory.pixels[1].copy()

    def visibility(self, angles: Float[Array, "37"]) -> Float32[Array, "P 91"]:
        """Share of every ray that comes from every Gaussian (equation 4)."""
        numba.set_num_threads(self._threads)
        return image_visibility(
            np.asarray(angles, np.float64), *self._body, self._rays, self._settings,
            self._scratch, self._memory,
        )  # fmt: skip

    @property
    def opacity(self) -> Float32[Array, "P"]:
        """Share of every ray that the body absorbed at the pose evaluated last."""
        return self._memory.pixels[2].copy()
