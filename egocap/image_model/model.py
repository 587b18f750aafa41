"""A body, the rays of a rig and settings, ready to evaluate poses against images, fast.

`ImageModel` is the compiled form of `egocap.image_model.appearance`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.skeleton import DOF_COUNT
from egocap.errors import InputError
from egocap.image_model.body_kernel import make_chain
from egocap.image_model.colour import ColourMeasure, blend_weights
from egocap.image_model.image_kernel import (
    Output,
    Palettes,
    RayArrays,
    Shape,
    image_energy,
    image_visibility,
)
from egocap.image_model.image_rays import ImageRays, ray_colours
from egocap.image_model.ray_kernel import CACHE_LINE, LANES, MAX_EDGES, make_scratch

WINDOW = 6.5
"""Length of the row of cells of a Gaussian in sigmas. The tails beyond go into the end cells."""
_ALL = np.zeros(0, np.int32)
_UNBINNED = Palettes(np.zeros(0, np.int32), np.zeros((1, 1), np.float32))
_NO_COLOURS = np.zeros((1, 3), np.float32)
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
        self._in_cone = measure.kind == "cone"
        reach = measure.reach
        self._colour_scale = np.float32(1.0 / reach**2 if self._in_cone else 2.0 / reach)
        self._chain = make_chain(body)
        self._shape = _shape(body, cell, cutoff, measure)
        self._rays = _ray_arrays(rays)
        self._cells = round(far / cell)
        self._threads = threads or numba.get_num_threads()
        count = len(body.parts)
        self._scratch = make_scratch(self._threads, count, self._cells)
        self._lists = np.zeros((len(rays.tile_view), count), np.int16)
        self._counts = np.zeros(len(rays.tile_view), np.int32)
        self._lanes = np.arange(MAX_EDGES, dtype=np.float32)
        self._pixels = np.zeros((3, len(rays)), np.float32)
        self._output = Output(
            np.zeros(self._threads), np.zeros((self._threads, count + CACHE_LINE, 3)),
            np.zeros((self._threads, DOF_COUNT + 1, DOF_COUNT)),
        )  # fmt: skip

    def colours(self, images: Sequence[UInt8[Array, "H W 3"]]) -> Float32[Array, "P 3"]:
        """What RGB images show along the rays, as `evaluate` takes it."""
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
        """Energy (equations 5 and 6), gradient and, on wish, Gauss-Newton matrix of a pose.

        `colours` are those of `self.colours`, or the bins of a `palette.Palette`. With `selected`,
        only these rays count, each times its weight. With `keep` < 1 each Gaussian's derivative is
        left out of each ray at random, and those kept count 1 / keep times: the gradient's
        expectation stays.
        """
        if isinstance(colours, Palettes):
            palettes, plain = colours, _NO_COLOURS
            assert palettes.bins.shape == (len(self.rays),), palettes.bins.shape
            assert len(palettes.unlike) == len(self.body.parts), palettes.unlike.shape
        else:
            palettes, plain = _UNBINNED, colours
            assert plain.shape == (len(self.rays), 3) and plain.dtype == np.float32, plain.shape
        numba.set_num_threads(self._threads)
        energy, gradient, matrix = image_energy(
            np.asarray(angles, np.float64), plain, palettes, self._chain, self._shape, self._rays,
            np.float32(self.cell), self._cells, self._in_cone, self._colour_scale, selected,
            weights, np.float32(keep), np.uint64(seed), bool(curvature), self._lanes, self._lists,
            self._counts, self._scratch, self._pixels, self._output,
        )  # fmt: skip
        return Evaluation(energy, gradient, matrix if curvature else None)

    def pixel_energies(
        self, angles: Float[Array, "37"], colours: Float32[Array, "P 3"] | Palettes
    ) -> tuple[Float32[Array, "P"], Float32[Array, "P"]]:
        """Energy of every ray, and how hard it pulls: the length of its derivative, per metre."""
        self.evaluate(angles, colours)
        return self._pixels[0].copy(), self._pixels[1].copy()

    def visibility(self, angles: Float[Array, "37"]) -> Float32[Array, "P 91"]:
        """Share of every ray that comes from every Gaussian (equation 4)."""
        numba.set_num_threads(self._threads)
        return image_visibility(
            np.asarray(angles, np.float64), self._chain, self._shape, self._rays,
            np.float32(self.cell), self._cells, self._lanes, self._lists, self._counts,
            self._scratch, self._threads,
        )  # fmt: skip

    @property
    def opacity(self) -> Float32[Array, "P"]:
        """Share of every ray that the body absorbed at the pose evaluated last."""
        return self._pixels[2].copy()


def _shape(body: GaussianBody, cell: float, cutoff: float, measure: ColourMeasure) -> Shape:
    sigma = np.array(body.sigma)
    depth = body.density * sigma * np.sqrt(2.0 * np.pi)
    radius2 = 2.0 * sigma**2 * np.log(np.maximum(depth / cutoff, 1.0))
    edges = LANES * np.ceil((WINDOW * sigma / cell + 1.0) / LANES)
    if edges.max() > MAX_EDGES:
        least = WINDOW * sigma.max() / (MAX_EDGES - 1)
        raise InputError(
            f"a Gaussian of sigma {sigma.max():.3f} m over cells of {cell} m",
            valid=f"cells of at least {least:.4f} m",
        )
    blend = np.stack(blend_weights(np.array(body.colour)), -1)
    return Shape(
        radius2=radius2.astype(np.float32),
        reach=np.sqrt(radius2).astype(np.float32),
        inv_2s2=(-0.5 / sigma**2).astype(np.float32),
        inv_s=(1.0 / (np.sqrt(2.0) * sigma)).astype(np.float32),
        inv_s2=(1.0 / sigma**2).astype(np.float32),
        half_depth=(depth / 2.0).astype(np.float32),
        edges=edges.astype(np.int32),
        colours=measure.features(np.array(body.colour)).astype(np.float32),
        blend=blend.astype(np.float32),
    )


def _ray_arrays(rays: ImageRays) -> RayArrays:
    return RayArrays(
        rays.origins, rays.view, rays.direction.astype(np.float32), rays.tile, rays.tile_view,
        rays.tile_axis.astype(np.float32), np.cos(rays.tile_angle).astype(np.float32),
        np.sin(rays.tile_angle).astype(np.float32),
    )  # fmt: skip
