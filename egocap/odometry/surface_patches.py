"""A small plane and its picture for every point: how its surroundings look from another pose.

Comparing each picture with the point's first one, warped, keeps points from creeping, which they do
when followed from frame to frame only. Source: affine tracking, Shi and Tomasi 1994; semi-direct
odometry, Forster et al. 2014.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap.odometry import patch_kernel as kernel
from egocap.odometry.views import Views

GRAZING = 0.2  # cosine to the normal below which a plane is taken as facing the camera
ALIKE = 0.75  # correlation of a patch that shows the same
REACH = 2.0  # px that alignment may move a followed corner
SCALES = 0.6, 1.7  # of a patch against its first picture, within which the latter is kept

_ROUNDS = 6


def appended(rows: Float[Array, "n *rest"], more: Float[Array, "m *rest"]) -> Array:
    """`rows` with `more` after them, which may overwrite what was appended to the same rows before.

    Memory is taken twice as large as needed, so that appending again and again takes linear time.
    """
    count, room = len(rows) + len(more), rows.base
    if not (isinstance(room, Array) and room.ctypes.data == rows.ctypes.data
            and room.shape[1:] == rows.shape[1:] and count <= len(room)):  # fmt: skip
        room = np.empty((2 * count, *rows.shape[1:]), np.result_type(rows, more))
        room[: len(rows)] = rows
    room[len(rows) : count] = more
    return room[:count]


@dataclass(eq=False)
class SurfacePatches:
    """Rows are points of a map. Geometry is that at the keyframe `host`, in its head frame."""

    host: Int[Array, "P"]  # row of the frame in the map
    view: Int[Array, "P"]
    ray: Float[Array, "P 3"]
    slope: Float[Array, "P 3 2"]  # of the ray by the pixel
    normal: Float[Array, "P 3"]  # of the plane, world
    picture: Float[Array, "P S"]
    sharpness: Float[Array, "P"]  # 1 / px, as `patch_kernel.sharpness`

    @classmethod
    def empty(cls) -> SurfacePatches:
        none = np.zeros(0, int)
        side = (kernel.SIDE + 2) ** 2
        return cls(none, none, np.zeros((0, 3)), np.zeros((0, 3, 2)), np.zeros((0, 3)),
                   np.zeros((0, side), np.float32), np.zeros(0))  # fmt: skip

    def __getitem__(self, rows: Array | slice) -> SurfacePatches:
        return SurfacePatches(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def extend(self, other: SurfacePatches) -> None:
        for name in self.__dataclass_fields__:
            setattr(self, name, appended(getattr(self, name), getattr(other, name)))

    def replace(self, rows: Int[Array, "n"], other: SurfacePatches) -> None:
        for name in self.__dataclass_fields__:
            getattr(self, name)[rows] = getattr(other, name)


def patches_at(
    views: Views, view: int, host: int, image: UInt8[Array, "H W"], pixels: Float[Array, "n 2"],
    normal: Float[Array, "n 3"],
) -> tuple[SurfacePatches, Bool[Array, "n"]]:  # fmt: skip
    """The patches around pixels of a keyframe, and whether they lie in the picture."""
    rays, slope, _, _ = views.rays_and_derivative(view, pixels)
    picture, inside = kernel.templates_at(image, pixels)
    n = len(pixels)
    found = SurfacePatches(np.full(n, host), np.full(n, view), rays, slope, normal, picture,
                           kernel.sharpness(picture))  # fmt: skip
    return found, inside


def surface_slope(
    ray: Float[Array, "n 3"], slope: Float[Array, "n 3 2"], distance: Float[Array, "n"],
    normal: Float[Array, "n 3"],
) -> Float[Array, "n 3 2"]:  # fmt: skip
    """Derivative of the point where a ray meets its plane, by the pixel [m/px].

    All in one frame of reference. Planes seen at a grazing angle are taken as facing the ray.
    """
    cosine = (normal * ray).sum(1)
    grazing = np.abs(cosine) < GRAZING
    n = np.where(grazing[:, None], ray, normal)
    along = np.einsum("ni,nik->nk", n, slope) / np.where(grazing, 1.0, cosine)[:, None]
    return distance[:, None, None] * (slope - ray[:, :, None] * along[:, None])


def warps(
    patches: SurfacePatches, rows: Int[Array, "n"], points: Float[Array, "n 3"],
    host_R: Float[Array, "n 3 3"], host_t: Float[Array, "n 3"], views: Views, view: int,
    pose: tuple[Float[Array, "3 3"], Float[Array, "3"]],
) -> Float[Array, "n 2 2"]:  # fmt: skip
    """Maps from offsets in each point's first picture to offsets in a view at a pose."""
    R, t = pose
    ray = np.einsum("nij,nj->ni", host_R, patches.ray[rows])
    slope = host_R @ patches.slope[rows]
    centre = host_t + np.einsum("nij,nj->ni", host_R, views.centres[patches.view[rows]])
    distance = np.linalg.norm(points - centre, axis=1)
    across = surface_slope(ray, slope, distance, patches.normal[rows])
    _, J, _ = views.project_jacobian(view, (points - t) @ R)
    return J @ (R.T @ across)


def fitting(A: Float[Array, "n 2 2"]) -> Bool[Array, "n"]:
    """Whether patches are neither much smaller nor larger nor thinner than at first."""
    size = np.linalg.svd(A, compute_uv=False)
    return (size[:, 1] > SCALES[0]) & (size[:, 0] < SCALES[1])


def aligned(
    patches: SurfacePatches, rows: Int[Array, "n"], image: UInt8[Array, "H W"],
    pixels: Float[Array, "n 2"], A: Float[Array, "n 2 2"],
) -> tuple[Float[Array, "n 2"], Bool[Array, "n"]]:  # fmt: skip
    """Pixels where the patches fit best near the given ones, and whether they do."""
    moved, score = kernel.align(
        patches.picture[rows], image, pixels, np.ascontiguousarray(A), _ROUNDS, REACH
    )
    return moved, score > ALIKE
