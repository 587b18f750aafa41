"""Procedural fabrics: seamless sRGB textures of woven, striped, checked and printed cloth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap_sim.human.body.noise import smooth_noise
from egocap_sim.human.body.skin import rgb

SIZE = 256  # px of drawn patterns; textures are downsampled to half
TILE_M = 0.24  # metres of cloth that a texture covers

PALETTE: dict[str, str] = {
    "white": "#e8e6e1", "cream": "#ded3ba", "sand": "#b9a684", "grey": "#8c8d8f",
    "charcoal": "#3d3f43", "black": "#1d1d20", "navy": "#1f2a48", "blue": "#2f569b",
    "sky": "#7fa8cf", "teal": "#1f6b70", "green": "#2f6b3f", "olive": "#5d6138",
    "mint": "#9cc7ae", "yellow": "#d9b23c", "mustard": "#b0832b", "orange": "#cf6a2a",
    "rust": "#9a4428", "red": "#b02a30", "burgundy": "#5f1f2d", "pink": "#d88fa0",
    "magenta": "#a83272", "purple": "#5b3f86", "lilac": "#a795c9", "brown": "#5c4130",
}  # fmt: skip

Colors = Float[Array, "3 3"]  # main, second and third colour, sRGB 0 to 1
Image = Float[Array, "256 256 3"]


@dataclass(frozen=True)
class Fabric:
    """Cloth by name: a pattern and up to three colours of `PALETTE`."""

    pattern: str
    colors: tuple[str, str, str]
    wear: float = 0.5  # 0 new, 1 faded and creased

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise InputError(f"unknown fabric pattern '{self.pattern}'", valid=PATTERNS)
        for color in self.colors:
            if color not in PALETTE:
                raise InputError(f"unknown cloth colour '{color}'", valid=PALETTE)
        if not 0 <= self.wear <= 1:
            raise InputError(f"wear is {self.wear}", valid="0 to 1")


def one_color(pattern: str, color: str) -> Fabric:
    """A fabric of a single colour."""
    return Fabric(pattern, (color, color, color))


def fabric_texture(fabric: Fabric, rng: np.random.Generator) -> UInt8[Array, "128 128 3"]:
    """Draw a fabric; it tiles in both directions. Rows run down the garment."""
    colors = np.array([rgb(PALETTE[c]) for c in fabric.colors], np.float32)
    image = PATTERNS[fabric.pattern](colors, rng).astype(np.float32)
    shade = 0.05 * smooth_noise(SIZE, 5, rng) + 0.03 * smooth_noise(SIZE, 40, rng)
    grain = 0.09 * rng.standard_normal((SIZE, SIZE), dtype=np.float32) + _weave()
    return _shaded(image, 1 + grain + (0.4 + 2.0 * fabric.wear) * shade)


@numba.njit(cache=True)
def _shaded(
    image: Float[Array, "256 256 3"], shade: Float[Array, "256 256"]
) -> UInt8[Array, "128 128 3"]:
    """The product as bytes, downsampled by 2."""
    half = SIZE // 2
    texture = np.empty((half, half, 3), np.uint8)
    for y in range(half):
        for x in range(half):
            for c in range(3):
                total = np.float32(0)
                for i in range(2 * x, 2 * x + 2):
                    for j in range(2 * y, 2 * y + 2):
                        total += image[j, i, c] * shade[j, i]
                mean = min(max(total / np.float32(4), np.float32(0)), np.float32(1))
                texture[y, x, c] = np.rint(mean * np.float32(255))
    return texture


def _weave() -> Float[Array, "256 256"]:
    """Plain weave with a period of four pixels."""
    k = np.arange(SIZE) // 2 % 2
    return np.where(k[:, None] == k[None, :], 0.04, -0.04).astype(np.float32)


def plain(colors: Colors, rng: np.random.Generator) -> Image:
    """One colour."""
    return np.broadcast_to(colors[0], (SIZE, SIZE, 3)).copy()


def stripes(colors: Colors, rng: np.random.Generator) -> Image:
    """Bands around the body, from 0.8 to 6 cm."""
    return _bands(colors, rng)[:, None].repeat(SIZE, 1)


def pinstripes(colors: Colors, rng: np.random.Generator) -> Image:
    """Thin lines along the body."""
    count = int(rng.integers(6, 20))
    line = (np.arange(SIZE) * count % SIZE) < 3 * count
    return np.where(line[None, :, None], colors[1], colors[0]).repeat(SIZE, 0)


def checks(colors: Colors, rng: np.random.Generator) -> Image:
    """Crossed bands, as in flannel shirts."""
    across, along = _bands(colors, rng), _bands(colors, rng)
    return 0.5 * across[:, None] + 0.5 * along[None, :]


def gingham(colors: Colors, rng: np.random.Generator) -> Image:
    """Even crossed bands of one colour on a light one."""
    count = int(rng.integers(4, 14))
    on = (np.arange(SIZE) * 2 * count // SIZE) % 2
    share = (on[:, None] + on[None, :])[..., None] / 2
    return colors[0] * share + colors[1] * (1 - share)


def dots(colors: Colors, rng: np.random.Generator) -> Image:
    """Round dots in staggered rows."""
    count = 2 * int(rng.integers(2, 8))
    radius = rng.uniform(0.18, 0.38)
    row = np.arange(SIZE) * count / SIZE
    y, x = np.meshgrid(row, row, indexing="ij")
    x = x + 0.5 * (np.floor(y) % 2)
    d = np.hypot(x % 1 - 0.5, y % 1 - 0.5)
    return np.where((d < radius)[..., None], colors[1], colors[0])


def shapes(colors: Colors, rng: np.random.Generator) -> Image:
    """Scattered discs, rings and blocks of the other colours."""
    image = plain(colors, rng)
    for _ in range(int(rng.integers(10, 30))):
        cy, cx, r = *rng.uniform(0, SIZE, 2), rng.uniform(0.03, 0.13) * SIZE
        kind, color = rng.integers(3), colors[1 + rng.integers(2)]
        rows, columns = (np.arange(np.ceil(c - r), c + r).astype(int) for c in (cy, cx))
        dy, dx = rows[:, None] - cy, columns[None, :] - cx
        d = np.maximum(abs(dy), abs(dx)) if kind == 0 else np.hypot(dy, dx)
        inside = (d < r) & ((d > 0.6 * r) | (kind != 2))
        window = np.ix_(rows % SIZE, columns % SIZE)
        image[window] = np.where(inside[..., None], color, image[window])
    return image


def camouflage(colors: Colors, rng: np.random.Generator) -> Image:
    """Patches of three colours."""
    blots = smooth_noise(SIZE, 7, rng) + 0.5 * smooth_noise(SIZE, 16, rng)
    return colors[np.digitize(blots, [-0.15, 0.25])]


def denim(colors: Colors, rng: np.random.Generator) -> Image:
    """Twill with faded streaks."""
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    twill = 0.05 * np.sign(np.sin(2 * np.pi * (x + y) * 96 / SIZE))
    streaks = 0.12 * smooth_noise(SIZE, (6, 90), rng) + 0.08 * smooth_noise(SIZE, 4, rng)
    return colors[0] * (1 + twill + streaks)[..., None] + 0.05


def marl(colors: Colors, rng: np.random.Generator) -> Image:
    """Melange yarn: short flecks of a second colour."""
    share = np.clip(0.35 + 0.5 * smooth_noise(SIZE, (128, 50), rng), 0, 1)[..., None]
    return colors[0] * (1 - 0.5 * share) + colors[1] * 0.5 * share


def knit(colors: Colors, rng: np.random.Generator) -> Image:
    """Ribs along the body."""
    rib = np.abs(np.sin(np.pi * np.arange(SIZE) * 40 / SIZE))
    return colors[0] * (0.72 + 0.34 * rib)[None, :, None].repeat(SIZE, 0)


PATTERNS: dict[str, Callable[[Colors, np.random.Generator], Image]] = {
    "plain": plain, "stripes": stripes, "pinstripes": pinstripes, "checks": checks,
    "gingham": gingham, "dots": dots, "shapes": shapes, "camouflage": camouflage,
    "denim": denim, "marl": marl, "knit": knit,
    "gradient": plain,  # `details.gradient` blends in the second colour
}  # fmt: skip


def _bands(colors: Colors, rng: np.random.Generator) -> Float[Array, "256 3"]:
    """One line of coloured bands, a random sequence repeated over the tile."""
    runs = int(rng.integers(2, 9))
    edges = np.sort(rng.uniform(0.15, 0.95, 3))
    place = (np.arange(SIZE) * runs / SIZE) % 1
    order = [0, 1, 0, 2] if rng.uniform() < 0.5 else [0, 1, 0, 1]
    return colors[np.array(order)[np.searchsorted(edges, place)]]
