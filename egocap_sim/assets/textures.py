"""Procedural textures of surfaces: seamless squares of known size, drawn from a generator."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numba import njit
from numpy import ndarray as Array
from numpy.typing import ArrayLike
from scipy.fft import ifft, irfft

from egocap_sim.assets.mesh import Material

SIZE = 512  # pixels along a texture
Rng = np.random.Generator


def noise(rng: Rng, low: float, high: float, steep: float = 1.0) -> Array:
    """Seamless noise (S, S), mean 0 and deviation 1, with `low` to `high` waves along an edge."""
    return _filtered(rng, low, high, steep, 1.0)


def grain(rng: Rng, stretch: float) -> Array:
    """Seamless noise stretched along the rows, like the grain of wood."""
    return _filtered(rng, 2, 200, 0.8, stretch)


def planks(rng: Rng) -> Material:
    """Wooden floorboards along x, each with its own tone."""
    count, tile = int(rng.integers(6, 11)), float(rng.uniform(1.1, 1.6))
    wood = _wood_colour(rng)
    row = np.arange(SIZE) * count // SIZE
    tone, shift = rng.normal(0, 0.07, count), rng.integers(0, SIZE, count)
    column = (np.arange(SIZE)[None, :] + shift[row][:, None]) % SIZE
    base = grain(rng, 14)[np.arange(SIZE)[:, None], column]
    value = 1 + tone[row][:, None] + 0.06 * base
    edge = (np.arange(SIZE) * count % SIZE) < 1.2 * count
    value[edge] *= 0.55
    value[column < 2] *= 0.65  # where boards meet end to end
    return Material(_tinted(value, wood), tile)


def tiles(rng: Rng, chequered: float = 0.4) -> Material:
    """Stone or ceramic tiles with grout, in two colours with this probability."""
    count, tile = 4, float(rng.uniform(1.2, 2.0))
    stone = rng.uniform(0.45, 0.85) * np.array(
        [1.0, rng.uniform(0.93, 1.0), rng.uniform(0.85, 1.0)]
    )
    i, j = np.meshgrid(np.arange(SIZE) * count // SIZE, np.arange(SIZE) * count // SIZE)
    tone = 1 + rng.normal(0, 0.03, (count, count))[j, i] + 0.04 * noise(rng, 2, 60)
    if rng.random() < chequered:
        tone = tone * np.where((i + j) % 2, 1.0, rng.uniform(0.45, 0.8))
    grout = ((np.arange(SIZE) * count) % SIZE) < rng.uniform(4, 7) * count
    tone = np.where(grout[:, None] | grout[None, :], rng.uniform(0.5, 0.8), tone)
    return Material(_tinted(tone, stone), tile)


def carpet(rng: Rng) -> Material:
    """Short pile in one colour with flecks."""
    value = 1 + 0.10 * noise(rng, 60, 250, 0.0) + 0.015 * noise(rng, 1, 8)
    return Material(_tinted(value, _cloth_colour(rng)), float(rng.uniform(0.8, 1.2)))


def concrete(rng: Rng) -> Material:
    """Smooth screed: clouds, and a few dark specks."""
    value = 1 + 0.05 * noise(rng, 1, 40, 1.3) + 0.05 * noise(rng, 60, 250, 0.0)
    value = np.where(noise(rng, 20, 120, 0.3) > 3.0, 0.75, value)
    return Material(_tinted(value, np.full(3, rng.uniform(0.45, 0.7))), 3.0)


def plaster(rng: Rng) -> Material:
    """Painted wall: a light colour with the roller's texture."""
    paint = np.array([0.86, 0.85, 0.82]) + rng.uniform(-0.12, 0.08, 3)
    value = 1 + 0.012 * noise(rng, 30, 200, 0.2) + 0.02 * noise(rng, 1, 6)
    return Material(_tinted(value, paint), 1.5)


def wallpaper(rng: Rng) -> Material:
    """Stripes, or a lattice of small motifs, on a light ground."""
    ground = rng.uniform(0.6, 0.9, 3)
    figure = np.clip(ground * rng.uniform(0.6, 0.9, 3), 0, 1)
    count = int(rng.integers(4, 9))
    x, y = np.meshgrid(np.arange(SIZE) / SIZE * count, np.arange(SIZE) / SIZE * count)
    if rng.random() < 0.5:
        mask = (x % 1.0) < rng.uniform(0.2, 0.6)
    else:
        x = x + 0.5 * (np.floor(y) % 2) if count % 2 == 0 else x
        u, v = x % 1.0 - 0.5, y % 1.0 - 0.5
        petals = 0.22 + 0.12 * np.cos(int(rng.integers(3, 7)) * np.arctan2(v, u))
        mask = np.hypot(u, v) < petals
    value = 1 + 0.015 * noise(rng, 30, 200)
    printed = np.where(mask[..., None], _tinted(value, figure), _tinted(value, ground))
    return Material(printed)


def bricks(rng: Rng) -> Material:
    """Brickwork in stretcher bond."""
    rows, columns = 12, 4
    y = np.arange(SIZE) * rows / SIZE
    shift = 0.5 * (np.floor(y) % 2)
    x = np.arange(SIZE)[None, :] * columns / SIZE + shift[:, None]
    i, j = np.floor(x).astype(int) % columns, np.floor(y).astype(int)[:, None] % rows
    mortar = (x % 1.0 < 0.05) | ((y % 1.0) < 0.13)[:, None]
    clay = np.array([0.60, 0.34, 0.27]) if rng.random() < 0.6 else np.array([0.8, 0.78, 0.74])
    tone = 1 + rng.normal(0, 0.1, (rows, columns))[j, i] + 0.05 * noise(rng, 4, 120, 0.6)
    wall = _tinted(tone, clay)
    wall[mortar] = to_bytes(np.array(rng.uniform(0.55, 0.8)))
    return Material(wall)


def wood(rng: Rng) -> Material:
    """Veneer for furniture."""
    return Material(_tinted(1 + 0.07 * grain(rng, 12), _wood_colour(rng)))


def lacquer(rng: Rng) -> Material:
    """One even colour: white, dark or bright."""
    colour = (np.full(3, 0.88), np.full(3, 0.15), rng.uniform(0.15, 0.8, 3))[int(rng.integers(3))]
    return even(colour)


def cloth(rng: Rng) -> Material:
    """Upholstery: a weave, sometimes striped or checked."""
    thread = np.sin(np.arange(SIZE) * 2 * np.pi / 8)
    colour, kind, count = _cloth_colour(rng), rng.random(), int(rng.integers(4, 10))
    band = np.arange(SIZE) * count // SIZE % 2 > 0
    if kind < 0.15:
        band = band[:, None] ^ band
    other = _cloth_colour(rng) if kind < 0.3 else colour
    value = 1 + 0.05 * np.outer(thread, thread) + 0.04 * noise(rng, 20, 200, 0.2)
    cloth = _tinted(value, other)
    if kind < 0.3:
        cloth = np.where(
            np.broadcast_to(band, value.shape)[..., None], _tinted(value, colour), cloth
        )
    return Material(cloth, 0.5)


def rug(rng: Rng) -> Material:
    """A patterned rug with borders."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE - 0.5
    edge = np.maximum(abs(x), abs(y))
    colours = np.stack([_cloth_colour(rng) for _ in range(4)])
    waves = rng.integers(2, 7, 2)
    field = np.sin(waves[0] * 2 * np.pi * (abs(x) + abs(y))) + np.cos(waves[1] * 4 * np.pi * x * y)
    index = np.where(field > 0.5, 1, 0)
    index = np.where((edge > 0.38) & (edge < 0.41), 2, np.where(edge > 0.45, 3, index))
    value = 1 + 0.08 * noise(rng, 60, 250, 0.0)
    return Material(to_bytes(colours.astype(np.float32)[index] * value[..., None]))


def books(rng: Rng) -> Material:
    """Book spines side by side, for one shelf."""
    colour, x = np.zeros((SIZE, SIZE, 3)), 0
    while x < SIZE:
        width, height = int(rng.integers(10, 34)), int(rng.integers(300, 490))
        spine = rng.uniform(0.1, 0.85, 3) * rng.uniform(0.5, 1.0)
        colour[SIZE - height :, x : x + width] = spine
        title = SIZE - height + int(rng.integers(20, 90))
        colour[title : title + 60, x + width // 3 : x + 2 * width // 3] = rng.uniform(0.6, 1.0)
        colour[:, x : x + 1] *= 0.3
        x += width
    return Material(to_bytes(colour))


def leaves(rng: Rng) -> Material:
    """Foliage: bright and dark greens in small patches."""
    value = 0.75 + 0.22 * noise(rng, 12, 120, 0.4) + 0.12 * noise(rng, 60, 250, 0.0)
    return Material(_tinted(value, np.array([0.28, 0.45, 0.16]) * rng.uniform(0.8, 1.2, 3)), 0.5)


def grass(rng: Rng) -> Material:
    """A lawn from above: blades of grass with drier patches."""
    value = _blades(rng) * (1 + 0.10 * noise(rng, 1, 12))
    dry = np.clip(0.25 + 0.25 * noise(rng, 1, 60), 0.0, 1.0)[..., None]
    green, straw = np.array([[0.33, 0.47, 0.18], [0.44, 0.46, 0.24]], np.float32)
    tint = rng.uniform(0.85, 1.15, 3).astype(np.float32)
    return Material(to_bytes(value[..., None] * tint * (green + dry * (straw - green))), 2.0)


def paving(rng: Rng) -> Material:
    """Concrete slabs outdoors."""
    slabs = tiles(rng, chequered=0.0)
    worn = 1 + 0.06 * noise(rng, 2, 200, 0.5)
    return Material(to_bytes(slabs.texture / 255.0 * 0.85 * worn[..., None]), 2.0)


def asphalt(rng: Rng) -> Material:
    """A road: dark, grainy, with worn tracks."""
    value = 1 + 0.12 * noise(rng, 60, 250, 0.0) + 0.08 * noise(rng, 1, 12, 1.2)
    return Material(_tinted(value, np.full(3, rng.uniform(0.2, 0.32))), 2.0)


def picture(rng: Rng) -> Material:
    """A wall picture of soft colour fields."""
    fields = np.stack([noise(rng, 1, int(rng.integers(3, 10)), 1.2) for _ in range(3)], -1)
    return Material(to_bytes(0.5 + 0.2 * fields * rng.uniform(0.2, 0.9, 3)))


def window(rng: Rng) -> Material:
    """A bright window with glazing bars: sky above, something green below."""
    along = np.arange(SIZE) / SIZE
    edge = np.minimum(along, 1 - along)
    across, down = np.minimum(abs(along - 0.5), edge), np.minimum(abs(along - 0.4), edge)
    horizon = 0.62 + 0.03 * noise(rng, 1, 8, 1.5)[0]
    seen = (along[:, None] > horizon).astype(np.uint8)
    seen[np.minimum.outer(down, across) < 0.025] = 2
    colours = np.array([[0.93, 0.96, 1.0], [0.72, 0.80, 0.66], [0.8, 0.8, 0.8]])
    return Material(to_bytes(colours)[seen])


def even(colour: ArrayLike) -> Material:
    """One colour, or one grey (sRGB, 0..1), everywhere."""
    return Material(np.broadcast_to(to_bytes(np.asarray(colour)), (4, 4, 3)).copy())


FLOORS: tuple[Callable[[Rng], Material], ...] = (planks, tiles, carpet, concrete)
WALLS: tuple[Callable[[Rng], Material], ...] = (plaster, plaster, wallpaper, bricks)


def _blades(rng: Rng) -> Float[Array, "S S"]:
    """Brightness of short strokes in all directions, mean 1; brighter strokes cover darker ones."""
    tones, each = 24, 600  # strokes of each tone
    longest, margin = 22, 24  # pixels
    canvas = np.full((SIZE + 2 * margin, SIZE + 2 * margin), 60, np.uint8)
    for tone in np.linspace(80, 200, tones):
        root, angle = rng.uniform(0, SIZE, (each, 2)), rng.uniform(0, 2 * np.pi, each)
        reach = np.stack([np.cos(angle), np.sin(angle)], 1) * rng.uniform(8, longest, (each, 1))
        strokes = np.rint(np.stack([root, root + reach], 1) + margin).astype(np.int32)
        cv2.polylines(canvas, list(strokes), False, tone, 1, cv2.LINE_AA)
    for _ in range(2):  # wrap rows, then columns, around the edges
        inner = canvas[margin:-margin]
        np.maximum(inner[:margin], canvas[-margin:], out=inner[:margin])
        np.maximum(inner[-margin:], canvas[:margin], out=inner[-margin:])
        canvas = inner.T
    return canvas / np.float32(canvas.mean())


def _filtered(
    rng: Rng, low: float, high: float, steep: float, stretch: float
) -> Float[Array, "S S"]:
    """Filtered white noise; only coefficients inside the pass band are drawn."""
    rows, columns = min(int(high), SIZE // 2 - 1), min(int(high / stretch), SIZE // 2)
    gain = _gain(rows, columns, low, high, steep, stretch)
    white = rng.standard_normal((*gain.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
    white[:rows, 0] = white[:rows:-1, 0].conj()  # Hermitian: the field is real
    spectrum = np.zeros((SIZE, columns + 1), np.complex64)
    spectrum[np.arange(-rows, rows + 1)] = white * gain
    field = np.asarray(irfft(ifft(spectrum, axis=0, overwrite_x=True), SIZE, axis=1))
    return (field - field.mean()) * (np.float32(1.0) / field.std())


@lru_cache(maxsize=32)
def _gain(
    rows: int, columns: int, low: float, high: float, steep: float, stretch: float
) -> Float[Array, "2*rows+1 columns+1"]:
    """Filter gain at vertical frequencies -rows..rows and horizontal ones 0..columns."""
    fy = np.arange(-rows, rows + 1, dtype=np.float32)[:, None]
    waves = np.hypot(fy, np.arange(columns + 1, dtype=np.float32) * np.float32(stretch))
    within = (waves >= low) & (waves <= high)
    return np.where(within, np.maximum(waves, 1.0) ** -steep, 0.0).astype(np.float32)


def _wood_colour(rng: Rng) -> Array:
    pale, dark = np.array([0.80, 0.66, 0.47]), np.array([0.36, 0.23, 0.14])
    return dark + (pale - dark) * rng.uniform(0, 1) * rng.uniform(0.9, 1.1, 3)


def _cloth_colour(rng: Rng) -> Array:
    grey = rng.uniform(0.25, 0.7)
    return np.clip(grey + rng.uniform(-0.18, 0.18, 3) * rng.uniform(0, 1), 0.05, 0.95)


def _tinted(value: Float[Array, "S S"], colour: Float[Array, "3"]) -> UInt8[Array, "S S 3"]:
    return _product(value.astype(np.float32), np.asarray(colour, np.float32))


@njit(cache=True, error_model="numpy")
def _product(value: Float[Array, "H W"], colour: Float[Array, "3"]) -> UInt8[Array, "H W 3"]:
    """sRGB bytes of a colour (0..1) times a brightness at each pixel, clipped at white."""
    height, width = value.shape
    texture = np.empty((height, width, 3), np.uint8)
    for y in range(height):
        for x in range(width):
            for c in range(3):
                level = min(max(value[y, x] * colour[c], np.float32(0.0)), np.float32(1.0))
                texture[y, x, c] = np.uint8(level * np.float32(255.0) + np.float32(0.5))
    return texture


def to_bytes(colour: Float[Array, "*n"]) -> UInt8[Array, "*n"]:
    """sRGB bytes of colours from 0 to 1, clipped at both ends."""
    return np.rint(np.clip(colour, 0.0, 1.0) * 255.0).astype(np.uint8)
