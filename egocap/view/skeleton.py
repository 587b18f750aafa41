"""A pose drawn over the pictures it was found in, and in three dimensions beside them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS, LIMBS
from egocap.body.side_colours import side_colour
from egocap.cameras.rig import Rig
from egocap.geometry import unit

BACKGROUND = 24
"""Grey value of what nothing is drawn on."""
GREY = (120, 120, 120)
"""Colour of other poses, such as the truth."""
SURE, DIMMED = 0.5, 0.45
"""Confidence under which a joint is drawn darker, and its share of the colour."""
EYE = np.array([2.6, 1.5, 0.4])
"""From where the three-dimensional view looks, head frame, metres: before, left, above."""
MIDST = np.array([0.1, 0.0, -0.75])
"""What it looks at: the middle of the body."""
FIELD = 2.0
"""Height of what it shows, metres at the distance of the body."""
_FLOOR = np.array([
    [x, y, 0.0] for near in (-1.0, -0.5, 0.0, 0.5, 1.0)
    for x, y in ((near, -1.0), (near, 1.0), (-1.0, near), (1.0, near))
])  # fmt: skip
"""Ends of the floor's lines, two after two."""
_WIDE, _NEAR = 3.2, 2.2
"""Field of the view in the world, as `FIELD`, and the distance to which it shows the way, short of
the camera, m."""
SURROUNDINGS, STANDS = (118, 128, 148), (240, 228, 66)
"""Colours of the points around the wearer, and of the marks of feet that stand."""
FEET = [LABELS.index(f"{side}_foot") for side in ("left", "right")]
"""Where such a mark is."""
_WAY = (170, 170, 170)


def side_by_side(
    images: Sequence[UInt8[Array, "H W 3"] | None], joints_head: Float[Array, "18 3"],
    confidence: Float[Array, "18"], rig: Rig, height: int = 360,
) -> UInt8[Array, "h w 3"]:  # fmt: skip
    """All views with the pose over them and the pose in 3-D, RGB, of one height.

    Both sides are even, as films want them.
    """
    height = height // 2 * 2
    ends = np.cumsum([*panel_widths(rig, height), height])
    canvas = np.full((height, int(ends[-1]), 3), BACKGROUND, np.uint8)
    *panels, space = np.split(canvas, ends[:-1], axis=1)
    draw_views(panels, images, joints_head, confidence, rig)
    draw_in_space(space, joints_head, confidence)
    return canvas


def panel_widths(rig: Rig, height: int) -> list[int]:
    """Widths of the views at a height, even."""
    return [round(camera.width * height / camera.height / 2) * 2 for camera in rig.cameras]


def draw_views(
    panels: Sequence[UInt8[Array, "h w 3"]], images: Sequence[UInt8[Array, "H W 3"] | None],
    joints_head: Float[Array, "18 3"], confidence: Float[Array, "18"], rig: Rig,
    grey: Sequence[Float[Array, "18 3"]] = (),
) -> None:  # fmt: skip
    """Fill every view's panel with its picture and the pose over it, other poses in grey below.

    A missing picture is black.
    """
    for panel, image in zip(panels, images, strict=True):
        _fill(panel, image)
    poses = [*((joints, None) for joints in grey), (joints_head, confidence)]
    for joints, sure in poses:
        pixels, inside = rig.project(joints)
        for v, camera in enumerate(rig.cameras):
            scale = np.divide(panels[v].shape[1::-1], (camera.width, camera.height))
            at = (np.where(inside[v][:, None], pixels[v], 0.0) + 0.5) * scale - 0.5
            draw_pose(panels[v], at, inside[v], sure)


def draw_pose(
    canvas: UInt8[Array, "H W 3"], points: Float[Array, "18 2"], shown: Array,
    confidence: Float[Array, "18"] | None,
) -> None:  # fmt: skip
    """Draw limbs and joints on an image: left blue, right vermilion, unsure ones darker.

    Without confidence all are grey.
    """
    import cv2

    thick = max(1, canvas.shape[0] // 150)
    at = np.rint(16.0 * points).astype(int)
    for a, b in LIMBS:
        if shown[a] and shown[b]:
            colour = _colour(confidence, b, a)
            cv2.line(canvas, at[a].tolist(), at[b].tolist(), colour, thick, cv2.LINE_AA, 4)
    for j in np.flatnonzero(shown).tolist():
        cv2.circle(canvas, at[j].tolist(), 24 * thick, _colour(confidence, j), -1, cv2.LINE_AA, 4)


def draw_in_space(
    canvas: UInt8[Array, "S S 3"], joints_head: Float[Array, "18 3"],
    confidence: Float[Array, "18"], grey: Sequence[Float[Array, "18 3"]] = (),
) -> None:  # fmt: skip
    """Draw the pose seen from before and the left, over a floor at its lowest foot; others grey."""
    size, everything = len(canvas), np.ones(len(LABELS), bool)
    floor = float(joints_head[:, 2].min())
    lines = _seen(_FLOOR + [0.0, 0.0, floor], size).reshape(-1, 2, 2)
    _draw_lines(canvas, lines, (58, 58, 58))
    for joints in grey:
        draw_pose(canvas, _seen(joints, size), everything, None)
    draw_pose(canvas, _seen(joints_head, size), everything, confidence)


def draw_in_world(
    canvas: UInt8[Array, "S S 3"], joints_world: Float[Array, "18 3"],
    confidence: Float[Array, "18"], way: Float[Array, "T 3"], points: Float[Array, "P 3"],
    stands: Bool[Array, "2"], grey: Sequence[Float[Array, "18 3"]] = (),
) -> None:  # fmt: skip
    """Draw the pose on the floor of the world, seen from beside: the camera follows, unturned.

    `way`: the head's last places up to now, drawn on the floor. `points`: of the surroundings.
    `stands`: whether the left and the right foot stand; such feet are ringed. Others grey.
    """
    import cv2

    size, head, everything = len(canvas), way[-1], np.ones(len(LABELS), bool)
    away = points - head
    before = (away - EYE) @ unit(MIDST - EYE) > 1.0
    at = np.rint(_seen(away[before], size, _WIDE)).astype(int)
    u, v = at[((at > 0) & (at < size - 1)).all(1)].T
    for row, column in ((v, u), (v, u - 1), (v - 1, u), (v - 1, u - 1)):
        canvas[row, column] = SURROUNDINGS
    lines = 2.0 * _FLOOR - [*(head[:2] % 1.0), head[2]]
    _draw_lines(canvas, _seen(lines, size, _WIDE).reshape(-1, 2, 2), (58, 58, 58))
    ends = _seen(way * [1.0, 1.0, 0.0] - head, size, _WIDE)
    near = np.linalg.norm((way - head)[:, :2], axis=1) < _NEAR
    _draw_lines(canvas, np.stack([ends[:-1], ends[1:]], 1)[near[:-1] & near[1:]], _WAY)
    for joints in grey:
        draw_pose(canvas, _seen(joints - head, size, _WIDE), everything, None)
    drawn = _seen(joints_world - head, size, _WIDE)
    draw_pose(canvas, drawn, everything, confidence)
    for u, v in np.rint(16.0 * drawn[FEET][stands]).astype(int).tolist():
        cv2.circle(canvas, (u, v), 16 * size // 70, STANDS, 2, cv2.LINE_AA, 4)


def _draw_lines(
    canvas: UInt8[Array, "H W 3"], lines: Float[Array, "N 2 2"], colour: tuple[int, int, int]
) -> None:
    import cv2

    ends = np.rint(16.0 * lines).astype(np.int32)
    cv2.polylines(canvas, ends, False, colour, 1, cv2.LINE_AA, 4)  # pyright: ignore


def _seen(points: Float[Array, "N 3"], size: int, field: float = FIELD) -> Float[Array, "N 2"]:
    """Pixels of points in the head frame, by a camera at `EYE`."""
    forward = unit(MIDST - EYE)
    right = unit(np.cross(forward, [0.0, 0.0, 1.0]))
    down = np.cross(forward, right)
    away = points - EYE
    depth = away @ forward
    focal = size / field * np.linalg.norm(MIDST - EYE)
    return np.stack([away @ right, away @ down], -1) / depth[:, None] * focal + size / 2


def _fill(panel: UInt8[Array, "h w 3"], image: UInt8[Array, "H W 3"] | None) -> None:
    """Put a picture into a panel, at its size."""
    import cv2

    if image is None:
        panel[:] = 0
        return
    height, width = panel.shape[:2]
    reduce = cv2.INTER_AREA if image.shape[0] > 2 * height else cv2.INTER_LINEAR
    cv2.resize(image, (width, height), panel, interpolation=reduce)


def _colour(confidence: Float[Array, "18"] | None, *labels: int) -> tuple[int, int, int]:
    """Of a joint, or of the limb to the first joint."""
    if confidence is None:
        return GREY
    r, g, b = side_colour(LABELS[labels[0]])
    share = 1.0 if min(confidence[j] for j in labels) >= SURE else DIMMED
    return round(share * r), round(share * g), round(share * b)
