"""Augmentation of canonical views: background, colour, geometry, occlusion and image quality.

Every function takes and returns pixels of canonical views (H, W, 3), uint8 RGB, and draws from an
explicit generator. Points are transformed with the image. Recolouring scales the colour of whole
parts, which keeps shading and texture; recolouring and background need part labels.
Source: EgoCap paper, section 4.3.1 (background, intrinsic recolouring, gamma, scale);
camouflage is an addition.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.detect.train.config import AugmentationConfig
from egocap.detect.train.examples import HIDDEN, OUTSIDE, SEEN, UNKNOWN, Example

WEARER = np.isin(np.arange(256), np.arange(1, 22)) | (np.arange(256) == 40)
"""Part labels of the wearer and the rig (`egocap_sim.core.part_labels`)."""

OUTFIT: tuple[tuple[int, ...], ...] = (
    (2, 3, 6, 7, 10, 11), (8, 12), (1, 14, 18), (15, 19), (16, 17, 20, 21), (4, 5, 9, 13),
)  # fmt: skip
"""Parts recoloured together: shirt, sleeves, hips and thighs, shins, shoes, skin."""
_CLOTHES = np.isin(np.arange(256), [p for garment in OUTFIT[:-1] for p in garment]).astype(np.uint8)
_LEAST_PX = 30  # of a garment, and of its background
_DIM = 16.0  # added to levels 0 to 255


def augment(
    example: Example,
    config: AugmentationConfig,
    rng: np.random.Generator,
    other: Example | None = None,
) -> Example:
    """Apply the augmentations of `config`; the image of `other` is the new background.

    Background, recolouring and camouflage need part labels and are skipped without them.
    """
    image, parts = example.image, example.parts
    background, recolour = rng.random() < config.background, rng.random() < config.recolour
    if parts is not None and recolour:
        image = recoloured(image, parts, rng)
    if parts is not None and background and other is not None:
        image = replaced_background(image, parts, other.image, rng)
    if parts is not None and rng.random() < config.camouflage:
        image = camouflaged(image, parts, rng)
    image, points, state = moved(image, example.points, example.state, config, rng)
    if rng.random() < config.occluders:
        image, state = occluded(image, points, state, rng)
    if rng.random() < config.blur:
        image = blurred(image, rng)
    if rng.random() < config.flare:
        image = flared(image, rng)
    if rng.random() < config.exposure:
        image = exposed(image, rng)
    image = toned(image, config, rng)
    if rng.random() < config.aberration:
        image = aberrated(image, rng)
    if rng.random() < config.rim:
        image, state = rimmed(image, points, state, rng)
    if rng.random() < config.noise:
        image = noisy(image, rng)
    if rng.random() < config.grey:
        image = greyed(image, rng)
    if rng.random() < config.jpeg:
        image = recompressed(image, rng)
    return Example(image, points, state)


def recoloured(
    image: UInt8[Array, "H W 3"], parts: UInt8[Array, "H W"], rng: np.random.Generator
) -> UInt8[Array, "H W 3"]:
    """Recolour clothes and skin: one factor per colour channel of each garment."""
    gain = np.ones((256, 3), np.float32)
    for garment, covered in enumerate(OUTFIT):
        if rng.random() < 0.7:
            spread = 0.12 if garment == len(OUTFIT) - 1 else 0.5  # natural range of skin
            factor = np.exp(rng.normal(0.0, 0.35) + rng.normal(0.0, spread, 3))
            gain[list(covered)] = np.clip(factor, 0.2, 4.0)
    # shift of hue: permute the channels of clothes, not of skin
    order = rng.permutation(3) if rng.random() < 0.4 else np.arange(3)
    source = image.copy()
    cv2.copyTo(np.ascontiguousarray(image[..., order]), cv2.LUT(parts, _CLOTHES), source)
    gains = cv2.LUT(cv2.merge([parts] * 3), gain[None])
    return cv2.multiply(source, gains, dtype=cv2.CV_8U)


def camouflaged(
    image: UInt8[Array, "H W 3"], parts: UInt8[Array, "H W"], rng: np.random.Generator
) -> UInt8[Array, "H W 3"]:
    """Give one garment about the colour of its background."""
    covered = OUTFIT[int(rng.integers(len(OUTFIT) - 1))]  # not the skin
    worn = np.isin(parts, covered)
    if np.count_nonzero(worn) < _LEAST_PX:
        return image
    near = cv2.dilate(worn.astype(np.uint8), np.ones((25, 25), np.uint8)) > 0
    behind = near & ~WEARER[parts] & _lit(image)  # without the black outside the image circle
    if np.count_nonzero(behind) < _LEAST_PX:
        return image
    colour = image[behind].mean(0) * np.exp(rng.normal(0.0, 0.12, 3))
    light = image[worn].mean(1) + _DIM  # dark cloth is mostly noise
    shading = np.clip(light / light.mean(), 0.5, 1.5)
    image = image.copy()
    image[worn] = np.minimum(colour * shading[:, None], 255.0).astype(np.uint8)
    return image


def replaced_background(
    image: UInt8[Array, "H W 3"],
    parts: UInt8[Array, "H W"],
    other: UInt8[Array, "H W 3"],
    rng: np.random.Generator,
) -> UInt8[Array, "H W 3"]:
    """Replace the background by another image, rotated so that its wearer is never upright."""
    behind = np.ascontiguousarray(other)
    height, width = parts.shape
    angle, zoom = rng.uniform(75.0, 285.0), np.exp(rng.uniform(np.log(1.3), np.log(3.0)))
    M = cv2.getRotationMatrix2D(
        (float(rng.uniform(0, width)), float(rng.uniform(0, height))), angle, zoom
    )
    behind = cv2.warpAffine(behind, M, (width, height), borderMode=cv2.BORDER_REFLECT_101)
    wearer = WEARER[parts]
    lens = _lit(image)  # the black outside the image circle is kept
    alpha = cv2.blur((wearer | ~lens).astype(np.float32), (3, 3))
    return cv2.blendLinear(image, behind, alpha, 1.0 - alpha)


def moved(
    image: UInt8[Array, "H W 3"],
    points: Float[Array, "18 2"],
    state: UInt8[Array, "18"],
    config: AugmentationConfig,
    rng: np.random.Generator,
) -> tuple[UInt8[Array, "H W 3"], Float[Array, "18 2"], UInt8[Array, "18"]]:
    """Scale, rotate and shift about the image centre; known labels that leave it become OUTSIDE."""
    height, width = image.shape[:2]
    scale = 1.0 + rng.uniform(-config.scale, config.scale)
    angle = rng.uniform(-config.rotation_deg, config.rotation_deg)
    shift = rng.uniform(-config.shift, config.shift, 2) * width
    if scale == 1.0 and angle == 0.0 and not shift.any():
        return image, points, state
    M = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), angle, scale)
    M[:, 2] += shift
    image = cv2.warpAffine(image, M, (width, height), flags=cv2.INTER_LINEAR)
    points = points @ M[:, :2].T + M[:, 2]
    inside = (points >= -0.5).all(-1) & (points <= (width - 0.5, height - 0.5)).all(-1)
    return image, points, np.where(inside | (state == UNKNOWN), state, OUTSIDE).astype(np.uint8)


def occluded(
    image: UInt8[Array, "H W 3"],
    points: Float[Array, "18 2"],
    state: UInt8[Array, "18"],
    rng: np.random.Generator,
) -> tuple[UInt8[Array, "H W 3"], UInt8[Array, "18"]]:
    """Draw one to three flat occluders; labels under them become HIDDEN."""
    height, width = image.shape[:2]
    cover = np.zeros((height, width), np.uint8)
    image = image.copy()
    for _ in range(rng.integers(1, 4)):
        shape = np.zeros_like(cover)
        centre = (int(rng.uniform(0, width)), int(rng.uniform(0, height)))
        if rng.random() < 0.5:
            axes = tuple(int(a) for a in rng.uniform(0.02, 0.13, 2) * width)
            cv2.ellipse(shape, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
        else:
            corners = np.array(centre) + rng.normal(0, 0.08 * width, (4, 2))
            cv2.fillPoly(shape, [cv2.convexHull(corners.astype(np.int32))], 1)
        colour = rng.integers(0, 256, 3)
        texture = rng.normal(0, 20, (max(1, height // 8), max(1, width // 8), 1))
        painted = np.clip(colour + texture, 0, 255).astype(np.uint8)
        cv2.copyTo(cv2.resize(painted, (width, height)), shape, image)
        cover |= shape
    at = np.clip(np.rint(points).astype(int), 0, (width - 1, height - 1))
    under = (cover[at[:, 1], at[:, 0]] > 0) & (state == SEEN)
    return image, np.where(under, HIDDEN, state).astype(np.uint8)


def blurred(image: UInt8[Array, "H W 3"], rng: np.random.Generator) -> UInt8[Array, "H W 3"]:
    """Defocus or motion blur."""
    if rng.random() < 0.5:
        return cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.3, 1.2)))
    length, angle = rng.uniform(1.0, 6.0), rng.uniform(0.0, np.pi)
    size = 9
    kernel = np.zeros((size, size), np.float32)
    for s in np.linspace(-0.5, 0.5, 16) * length:
        at = (size // 2 + s * np.cos(angle), size // 2 + s * np.sin(angle))
        kernel[int(np.rint(at[1])), int(np.rint(at[0]))] += 1.0 / 16
    return cv2.filter2D(image, -1, kernel)


def toned(
    image: UInt8[Array, "H W 3"], config: AugmentationConfig, rng: np.random.Generator
) -> UInt8[Array, "H W 3"]:
    """Change gamma, and at random colour temperature, contrast and saturation."""
    gamma = np.exp(rng.uniform(-1.0, 1.0) * np.log(config.gamma))
    curve = np.linspace(0.0, 1.0, 256)[:, None] ** gamma * np.ones(3)
    if rng.random() < config.colour:
        warmth = rng.normal(0.0, 0.12)
        contrast, brightness = rng.uniform(0.7, 1.3), rng.normal(0.0, 0.06)
        curve = (curve * np.exp([warmth, rng.normal(0.0, 0.04), -warmth]) - 0.5) * contrast
        curve = curve + 0.5 + brightness
        if rng.random() < 0.3:
            grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None]
            keep = rng.uniform(0.0, 1.8)
            image = cv2.addWeighted(image, keep, np.repeat(grey, 3, 2), 1.0 - keep, 0.0)
    table = np.clip(np.rint(curve * 255.0), 0, 255).astype(np.uint8)
    return cv2.LUT(image, table[None])


def exposed(image: UInt8[Array, "H W 3"], rng: np.random.Generator) -> UInt8[Array, "H W 3"]:
    """Change the exposure by up to 1.5 stops; what exceeds white is clipped."""
    light = (np.arange(256) / 255.0) ** 2.2 * 2.0 ** rng.uniform(-1.5, 1.5)
    table = np.rint(255.0 * np.minimum(light, 1.0) ** (1.0 / 2.2)).astype(np.uint8)
    return cv2.LUT(image, table)


def flared(image: UInt8[Array, "H W 3"], rng: np.random.Generator) -> UInt8[Array, "H W 3"]:
    """Add the glow of a lamp or the sun: a soft spot and a veil over the whole image."""
    height, width = image.shape[:2]
    x, y = rng.uniform(0, width), rng.uniform(0, height)
    v, u = np.ogrid[:height, :width]
    far = ((u - x) ** 2 + (v - y) ** 2) / (width * rng.uniform(0.05, 0.3)) ** 2
    glow = (rng.uniform(40, 200) / (1.0 + far) + rng.uniform(0, 20)).astype(np.float32)
    colour = (1.0 + rng.normal(0.0, 0.08, 3)).astype(np.float32)
    return np.minimum(image + glow[..., None] * colour, 255.0).astype(np.uint8)


def aberrated(image: UInt8[Array, "H W 3"], rng: np.random.Generator) -> UInt8[Array, "H W 3"]:
    """Lateral chromatic aberration: red and blue are magnified by up to 1 % more or less."""
    height, width = image.shape[:2]
    strength = rng.uniform(-0.01, 0.01)
    image = image.copy()
    for channel, sign in ((0, 1.0), (2, -1.0)):
        M = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0, 1 + sign * strength)
        image[..., channel] = cv2.warpAffine(image[..., channel].copy(), M, (width, height))
    return image


def rimmed(
    image: UInt8[Array, "H W 3"],
    points: Float[Array, "18 2"],
    state: UInt8[Array, "18"],
    rng: np.random.Generator,
) -> tuple[UInt8[Array, "H W 3"], UInt8[Array, "18"]]:
    """Black out what lies outside an ellipse with a soft edge; labels there become OUTSIDE."""
    height, width = image.shape[:2]
    centre = np.array([width, height]) / 2 + rng.normal(0.0, 0.06 * width, 2)
    half = np.array([width, height]) / 2 * rng.uniform(0.75, 1.3) * rng.uniform(0.9, 1.1, 2)
    v, u = np.ogrid[:height, :width]
    ratio = np.sqrt(((u - centre[0]) / half[0]) ** 2 + ((v - centre[1]) / half[1]) ** 2)
    light = np.clip((1.0 - ratio) / rng.uniform(0.01, 0.15), 0.0, 1.0).astype(np.float32)
    beyond = ((((points - centre) / half) ** 2).sum(-1) > 1.0) & (state != UNKNOWN)
    return (image * light[..., None]).astype(np.uint8), np.where(beyond, OUTSIDE, state).astype(
        np.uint8
    )


def greyed(image: UInt8[Array, "H W 3"], rng: np.random.Generator) -> UInt8[Array, "H W 3"]:
    """The image of a monochrome camera with a random spectral sensitivity."""
    weights = rng.dirichlet([2.0, 3.0, 2.0]).astype(np.float32)
    return cv2.transform(image, np.tile(weights, (3, 1)))


def noisy(image: UInt8[Array, "H W 3"], rng: np.random.Generator) -> UInt8[Array, "H W 3"]:
    """Add sensor noise, grey or coloured."""
    height, width = image.shape[:2]
    channels = 3 if rng.random() < 0.5 else 1
    # the sum of two 8-bit uniform draws is nearly normal and much cheaper than normal draws
    raw = rng.integers(0, 256, (2, height, width, channels), np.uint8)
    scale = rng.uniform(1.0, 12.0) / 104.5  # 104.5: the sum's standard deviation
    noise = cv2.addWeighted(raw[0], scale, raw[1], scale, -255.0 * scale, dtype=cv2.CV_32F)
    return cv2.add(image, noise if channels == 3 else cv2.merge([noise] * 3), dtype=cv2.CV_8U)


def recompressed(image: UInt8[Array, "H W 3"], rng: np.random.Generator) -> UInt8[Array, "H W 3"]:
    """Compress as JPEG at quality 12 to 90."""
    import simplejpeg

    data = simplejpeg.encode_jpeg(
        np.ascontiguousarray(image), quality=int(rng.integers(12, 90)), colorsubsampling="420"
    )
    return simplejpeg.decode_jpeg(data)


def _lit(image: UInt8[Array, "H W 3"]) -> Bool[Array, "H W"]:
    """Pixels that are not black."""
    return cv2.transform(image, np.ones((1, 3), np.float32)) > 0
