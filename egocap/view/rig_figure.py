"""A rig on a head: from three sides, what its views show of a wearer, what they see over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import LABELS, LIMBS
from egocap.body.proportions import Proportions
from egocap.body.side_colours import side_colour, side_hex
from egocap.body.skeleton import forward
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount, Rig
from egocap.errors import FileError, InputError
from egocap.files import make_folder, read_bytes, replacing
from egocap.image_model.image_rays import image_rays, ray_image
from egocap.image_model.model import ImageModel
from egocap.media.decoding import decode
from egocap.pose.initial_poses import STARTS, start_poses
from egocap.posterior.rig_coverage import RigCoverage, everyday_poses, rig_coverage

SIDES = (("from the right", 0, 2), ("from the front", 1, 2), ("from above", 1, 0))
"""Titles and the head axes that run right and up in the drawing."""
POSES = ("standing", "sitting")
MARKS = ("o", "s", "^", "D")
"""Of the cameras in turn; their colour is that of their side."""
_STARTS = {"standing": "rest", "sitting": "sitting"}
_HEAD = np.array([0.01, 0.0, 0.06]), np.array([0.095, 0.075, 0.115])
"""Centre and half axes of the drawn head, metres."""
_WIDTH = 240
_RINGS_DEG = (30, 60, 90)


def pose_of(name: str) -> Float[Array, "37"]:
    """Angles of one of `POSES`."""
    return start_poses()[list(STARTS).index(_STARTS[name])]


def draw_rig(
    rig: Rig, out: Path, proportions: Proportions, count: int = 200, sigma: float = 2.0,
    beside: UInt8[Array, "H W 3"] | None = None, view: str | None = None,
) -> RigCoverage:  # fmt: skip
    """Write the picture of a rig as PNG; returns what it says of visibility and bound.

    `beside` is a photo of `view` (by default the first), drawn beside the model in that view.
    Raises InputError for a view or picture that does not fit, and as `egocap.files.disk_errors`.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    if out.suffix != ".png":
        raise InputError(f"{out}", valid="the name of a .png file")
    at = _view_index(rig, view)
    if beside is not None:
        _require_shape(beside, rig.mounts[at])
    poses = everyday_poses(count, np.random.default_rng(0))
    coverage = rig_coverage(rig, proportions, poses, sigma)
    V = len(rig.mounts)
    rows = 2 + -(-2 * V // 4) + (beside is not None)
    figure = plt.figure(figsize=(15.0, 4.4 * rows), dpi=80, layout="constrained")
    grid = figure.add_gridspec(rows, 12)
    for i, (title, right, up) in enumerate(SIDES):
        _side(figure.add_subplot(grid[0, 4 * i : 4 * i + 4]), rig, proportions, title, right, up)
    shown = _views(rig, proportions)
    for i, (title, image) in enumerate(shown):
        axes = figure.add_subplot(grid[1 + i // 4, 3 * (i % 4) : 3 * (i % 4) + 3])
        _picture(axes, image, title, rig.cameras[i // len(POSES)])
    row = 1 + -(-2 * V // 4)
    _bars(figure.add_subplot(grid[row, :6]), coverage)
    _bounds(figure.add_subplot(grid[row, 6:]), coverage, sigma)
    if beside is not None:
        camera, model = rig.cameras[at], shown[at * len(POSES)]
        _picture(figure.add_subplot(grid[-1, :6]), beside, f"photo, {rig.views[at]}", camera)
        _picture(figure.add_subplot(grid[-1, 6:]), model[1], f"model, {model[0]}", camera)
    figure.suptitle(_title(rig, coverage))
    make_folder(out.parent)
    with replacing(out, keep_suffix=True) as temporary:
        figure.savefig(temporary)
    plt.close(figure)
    return coverage


def load_photo(path: Path) -> UInt8[Array, "H W 3"]:
    """An RGB picture. Raises FileError."""
    import cv2

    image = decode(read_bytes(path), cv2.IMREAD_COLOR_RGB, path)
    if image is None:
        raise FileError(path, "not a picture", valid="a .png or .jpg file")
    return np.asarray(image, np.uint8)


def _view_index(rig: Rig, view: str | None) -> int:
    if view is not None and view not in rig.views:
        raise InputError(f"no view '{view}'", valid=rig.views)
    return 0 if view is None else rig.views.index(view)


def _require_shape(image: UInt8[Array, "H W 3"], mount: Mount) -> None:
    height, width = image.shape[:2]
    camera = mount.camera
    if abs(width * camera.height - height * camera.width) > max(camera.width, camera.height):
        raise InputError(f"a picture of {width} x {height} in view '{mount.name}'",
                         valid=f"the shape of {camera.width} x {camera.height}")  # fmt: skip


def _title(rig: Rig, coverage: RigCoverage) -> str:
    of = coverage.summary
    return (f"{rig.name}: joints seen by a view {of['any_view']:.0%} of the time, by all "
            f"{of['all_views']:.0%}; Cramer-Rao bound {of['bound_mm']:.0f} mm")  # fmt: skip


def _side(axes: Any, rig: Rig, proportions: Proportions, title: str, right: int, up: int) -> None:
    """Head, upper body, cameras with their axes and cones, projected along one head axis."""
    from matplotlib.patches import Ellipse

    centre, half = _HEAD
    sign = -1.0 if right == 1 else 1.0  # the left is to the left from behind and above
    flip = -sign if title == "from the front" else sign
    axes.add_patch(
        Ellipse((flip * centre[right], centre[up]), 2 * half[right], 2 * half[up], color="0.85")
    )
    joints = forward(proportions, pose_of("standing"))
    for a, b in LIMBS:
        axes.plot(flip * joints[[a, b], right], joints[[a, b], up], color="0.6", lw=2, zorder=1)
    axes.plot(0, 0, "k+", markersize=10, label="skull base")
    for mount, mark in zip(rig.mounts, MARKS * 4, strict=False):
        _camera(axes, mount, mark, (right, up), flip)
    axes.set(xlim=(-0.75, 0.75), ylim=(-0.95, 0.45) if up == 2 else (-0.6, 0.8), aspect="equal",
             title=title, xlabel="m", ylabel="m")  # fmt: skip
    axes.legend(fontsize=8, loc="lower right")


def _camera(axes: Any, mount: Mount, mark: str, plane: tuple[int, int], flip: float) -> None:
    """A mark, the optical axis, and the rays at the borders of the image through its centre."""
    T, colour = mount.T_head_camera, side_hex(mount.name.rpartition("_")[2])  # as front_left
    place, (right, up) = T[:3, 3], plane
    axes.plot(flip * place[right], place[up], mark, color=colour, label=mount.name, zorder=3)
    tip = place + 0.25 * T[:3, 2]
    axes.plot(flip * np.array([place[right], tip[right]]), [place[up], tip[up]], color=colour)
    rays, _ = mount.camera.ray(_border(mount.camera))
    for ray in rays @ T[:3, :3].T:
        end = place + 0.5 * ray
        axes.plot(flip * np.array([place[right], end[right]]), [place[up], end[up]], "--",
                  color=colour, lw=0.8)  # fmt: skip


def _border(camera: Camera) -> Float[Array, "4 2"]:
    """Middles of the image's four sides, or the rim of the lens where that is inside."""
    (u, v), (w, h) = camera.centre, (camera.width - 1.0, camera.height - 1.0)
    sides = np.array([[0.0, v], [w, v], [u, 0.0], [u, h]])
    rim, _ = camera.project(
        np.stack([
            [s * np.sin(camera.max_angle), c * np.sin(camera.max_angle), np.cos(camera.max_angle)]
            for s, c in ((-1, 0), (1, 0), (0, -1), (0, 1))
        ])
    )  # fmt: skip
    middle = np.array(camera.centre)
    nearer = np.linalg.norm(rim - middle, axis=1) < np.linalg.norm(sides - middle, axis=1)
    return np.where(nearer[:, None], rim, sides)


def _views(rig: Rig, proportions: Proportions) -> list[tuple[str, Float[Array, "H W 3"]]]:
    """The volumetric body in every view, in every pose, left parts blue, right parts orange."""
    body = GaussianBody.from_proportions(proportions)
    colours = np.array([_part_colour(part) for part in body.parts])
    found = []
    for mount in rig.mounts:
        camera = mount.camera
        alone = Rig("one", (mount,))
        rays = image_rays(alone, _WIDTH, max(round(_WIDTH * camera.height / camera.width), 1))
        model = ImageModel(body, rays)
        for name in POSES:
            seen = model.visibility(pose_of(name))
            shade = seen @ colours + (1.0 - seen.sum(1, keepdims=True)) * 0.12
            image = np.clip(ray_image(rays, shade, 0.0)[0], 0.0, 1.0)
            found.append((f"{mount.name}, {name}", image))
    return found


def _part_colour(part: str) -> Sequence[float]:
    dim = 0.75 if part.endswith(("forearm", "shank")) else 1.0
    return [dim * c / 255.0 for c in side_colour(part, (217, 217, 217))]


def _picture(axes: Any, image: Array, title: str, camera: Camera) -> None:
    """A picture in the camera's pixels, with rings of equal angle off the axis."""
    axes.imshow(image, extent=(-0.5, camera.width - 0.5, camera.height - 0.5, -0.5))
    turn = np.linspace(0.0, 2 * np.pi, 181)
    for ring in _RINGS_DEG:
        theta = np.deg2rad(ring)
        if theta > camera.max_angle + 1e-9:
            continue
        rays = np.stack([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn),
                         np.full(len(turn), np.cos(theta))], -1)  # fmt: skip
        pixels, _ = camera.project(rays)
        axes.plot(*pixels.T, color="w", lw=0.5, alpha=0.7)
        axes.annotate(f"{ring}°", pixels[0], color="w", fontsize=7, annotation_clip=True)
    axes.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), title=title)
    axes.set_axis_off()


def _bars(axes: Any, coverage: RigCoverage) -> None:
    places = np.arange(len(LABELS))
    axes.bar(places, 100 * coverage.any_view, color="0.75", label="by a view")
    axes.bar(places, 100 * coverage.all_views, color="tab:blue", width=0.5, label="by all views")
    axes.set(ylabel="%", ylim=(0, 100))
    axes.set_title("share of everyday poses in which a joint is seen", loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=8)
    _label(axes)


def _bounds(axes: Any, coverage: RigCoverage, sigma: float) -> None:
    axes.bar(np.arange(len(LABELS)), coverage.bound_mm, color="tab:purple")
    axes.set(title=f"Cramer-Rao bound of one frame, detections of {sigma:g} px at 640",
             ylabel="mm, root mean square")  # fmt: skip
    _label(axes)


def _label(axes: Any) -> None:
    axes.set_xticks(np.arange(len(LABELS)), [n.replace("_", " ") for n in LABELS], rotation=60,
                    ha="right", fontsize=8)  # fmt: skip
    axes.grid(axis="y", alpha=0.3)
