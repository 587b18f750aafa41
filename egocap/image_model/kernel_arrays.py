"""What the image kernels read and write, as named tuples of arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int16, Int32, UInt64
from numba import njit
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.skeleton import DOF_COUNT, JOINTS
from egocap.errors import InputError
from egocap.image_model.colour_measure import ColourMeasure, blend_weights
from egocap.image_model.image_rays import ImageRays

LANES = 16
"""Edges of a Gaussian's cells come in multiples of this."""
MAX_EDGES = 64
CACHE_LINE = 32
"""Numbers of single precision that fill two cache lines, which processors fetch together."""
WINDOW = 6.5
"""Length of the row of cells of a Gaussian in sigmas. The tails beyond go into the end cells."""


class GaussianArrays(NamedTuple):
    """What rays need of the Gaussians, single precision."""

    radius2: Float32[Array, "G"]  # squared distance from a ray beyond which it is left out
    reach: Float32[Array, "G"]  # its root
    inv_2s2: Float32[Array, "G"]  # -1 / (2 sigma^2)
    inv_s: Float32[Array, "G"]  # 1 / (sqrt(2) sigma)
    inv_s2: Float32[Array, "G"]  # 1 / sigma^2
    half_depth: Float32[Array, "G"]  # half of the optical depth through the centre
    edges: Int32[Array, "G"]
    colours: Float32[Array, "G 3"]
    blend: Float32[Array, "G 3"]


class Settings(NamedTuple):
    """Cells along the rays, and how colours are compared."""

    cell: np.float32  # metres
    cells: int
    in_cone: bool
    colour_scale: np.float32  # 2 / reach for the paper's hues, 1 / reach^2 in the cone


class Scratch(NamedTuple):
    """Working memory of one thread, single precision."""

    near: UInt64[Array, "G"]  # the Gaussians near the ray
    first: UInt64[Array, "G"]  # first cell of each
    middle: Float32[Array, "G"]  # m, metres
    half: Float32[Array, "G"]  # half of the optical depth
    like: Float32[Array, "G"]  # dissimilarity to the ray's colour
    across: Float32[Array, "G 3"]  # from the ray to the centre, metres
    step: Float32[Array, "G 3"]  # derivative of the energy by the centre
    erf: Float32[Array, "G E"]
    bell: Float32[Array, "G E"]
    depth: Float32[Array, "K"]
    coloured: Float32[Array, "K"]
    share: Float32[Array, "K"]  # U
    rest: Float32[Array, "K"]  # V
    sums: Float32[Array, "16"]
    moments: Float32[Array, "16"]


def make_scratch(threads: int, gaussians: int, cells: int) -> Scratch:
    """Working memory of several threads, stacked, for so many Gaussians and cells along a ray."""
    longest = cells + MAX_EDGES + LANES
    # Rows of two threads do not share a cache line.
    row = gaussians + CACHE_LINE
    shapes = [(row,)] * 3 + [(row, 3)] * 2 + [(row, MAX_EDGES + 1)] * 2
    shapes += [(longest + CACHE_LINE,)] * 4 + [(LANES + CACHE_LINE,)] * 2
    ints = (np.zeros((threads, row), np.uint64) for _ in range(2))
    return Scratch(*ints, *(np.zeros((threads, *shape), np.float32) for shape in shapes))


@njit(cache=True, inline="always")
def thread_scratch(all_, thread):
    """One thread's part of the stacked working memory."""
    return Scratch(
        all_.near[thread], all_.first[thread], all_.middle[thread], all_.half[thread],
        all_.like[thread], all_.across[thread], all_.step[thread], all_.erf[thread],
        all_.bell[thread], all_.depth[thread], all_.coloured[thread], all_.share[thread],
        all_.rest[thread], all_.sums[thread], all_.moments[thread],
    )  # fmt: skip


class RayArrays(NamedTuple):
    """`image_rays.ImageRays` in the kernel's precision."""

    origins: Float[Array, "V 3"]
    camera: Int32[Array, "P"]  # the view, under a name that numba does not take for a method
    direction: Float32[Array, "P 3"]
    tile: Int32[Array, "P"]
    tile_view: Int32[Array, "N"]
    tile_axis: Float32[Array, "N 3"]
    tile_cos: Float32[Array, "N"]
    tile_sin: Float32[Array, "N"]


class Posed(NamedTuple):
    """The body in a pose, as the views see it."""

    origins: Float[Array, "17 3"]  # of joints
    axes: Float[Array, "37 3"]
    centres: Float[Array, "G 3"]
    arms: Float32[Array, "V G 3"]  # from the camera to the centre
    cones: Float32[Array, "V 5 G"]  # direction, cos and sin of the angle


class Palettes(NamedTuple):
    """Colours by bins: which bin every ray is in, and how unlike each Gaussian every bin is."""

    bins: Int32[Array, "P"]
    unlike: Float32[Array, "G K"]


class RayColours(NamedTuple):
    """Colours along the rays: as features, or in the bins of `Palettes`."""

    features: Float32[Array, "P 3"]
    bins: Int32[Array, "P"]  # empty: features are compared
    unlike: Float32[Array, "G K"]


class Request(NamedTuple):
    """What to evaluate: see `ImageModel.evaluate`."""

    selected: Int32[Array, "S"]  # empty: all rays
    weights: Float32[Array, "S"]
    keep: np.float32
    seed: np.uint64
    curvature: bool


class Memory(NamedTuple):
    """Working memory and results. C threads have a row each, a cache line apart."""

    lists: Int16[Array, "N G"]  # Gaussians of every tile
    counts: Int32[Array, "N"]
    lanes: Float32[Array, "E"]  # 0, 1, 2, ...
    pixels: Float32[Array, "3 P"]  # energy, length of its derivative, opacity
    energy: Float[Array, "C"]
    by_centre: Float[Array, "C G 3"]  # derivative by the Gaussians' centres
    curvature: Float[Array, "C 37 37"]  # lower triangle
    wrench: Float[Array, "C 17 6"]  # zero between rays, as is `loaded`
    loaded: Bool[Array, "C 17"]
    row: Float[Array, "C 37"]
    which: Int[Array, "C 37"]


def make_memory(threads: int, rays: int, tiles: int, gaussians: int, lanes: int) -> Memory:
    """Working memory for so many threads, rays, tiles and Gaussians."""
    joints, dofs, apart = len(JOINTS), DOF_COUNT, CACHE_LINE
    return Memory(
        np.zeros((tiles, gaussians), np.int16), np.zeros(tiles, np.int32),
        np.arange(lanes, dtype=np.float32), np.zeros((3, rays), np.float32), np.zeros(threads),
        np.zeros((threads, gaussians + apart, 3)), np.zeros((threads, dofs + 1, dofs)),
        np.zeros((threads, joints + apart, 6)), np.zeros((threads, joints + 4 * apart), bool),
        np.zeros((threads, dofs + apart)), np.zeros((threads, dofs + apart), np.int64),
    )  # fmt: skip


class Thread(NamedTuple):
    """One thread's part of the working memory."""

    scratch: Scratch
    by_centre: Float[Array, "G 3"]
    wrench: Float[Array, "17 6"]
    loaded: Bool[Array, "17"]


def gaussian_arrays(
    body: GaussianBody, cell: float, cutoff: float, measure: ColourMeasure
) -> GaussianArrays:
    """The arrays of a body: see `ImageModel`. Raises InputError for cells that are too small."""
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
    return GaussianArrays(
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


def ray_arrays(rays: ImageRays) -> RayArrays:
    """The arrays of the rays."""
    return RayArrays(
        rays.origins, rays.view, rays.direction.astype(np.float32), rays.tile, rays.tile_view,
        rays.tile_axis.astype(np.float32), np.cos(rays.tile_angle).astype(np.float32),
        np.sin(rays.tile_angle).astype(np.float32),
    )  # fmt: skip
