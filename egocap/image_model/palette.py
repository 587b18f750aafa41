"""Colour distributions of a person's Gaussians and of the background: a likelihood ratio.

The paper's measure compares a pixel with a Gaussian only. Where the background is like the person,
that rewards a body that covers it. Here the image is a mixture: along a ray, Gaussian q is seen
with probability V_q and the background with the rest. With p_q and p_0 the distributions of their
colours, the dissimilarity of a colour c is

    d_q(c) = clip(log(p_0(c) / p_q(c)) / LOG_RATIO, -1, 1),

the log-likelihood ratio: -1 for a colour that is the Gaussian's own, 1 for one that is not, and 0
for an uninformative colour, which both body and background have or neither has.

Distributions are histograms over brightness and two chromaticities that shading does not change,
smoothed. A Gaussian's own pixels count first; those of its part, of the whole person, and an even
floor fill in the rest. The background's is learned in every frame from the rays beside the body.

Source: likelihood-ratio region tracking, e.g. Prisacariu & Reid 2012, "PWP3D: real-time
segmentation and tracking of 3D objects"; Bibby & Reid 2008, "Robust real-time visual tracking using
pixel-wise posteriors"; the place in the energy is EgoCap 2016, equation 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, UInt8
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import without_side
from egocap.errors import InputError
from egocap.image_model.colour_measure import hsv_to_rgb, rgb_to_hsv
from egocap.image_model.image_rays import ImageRays, PosedFrames, ray_colours
from egocap.image_model.kernel_arrays import Palettes
from egocap.image_model.model import ImageModel

LOG_RATIO = 3.0
"""Logarithm of the ratio of likelihoods that counts in full."""
DIM = 0.1
"""Brightness at which a hue is half as reliable."""
OWN_PIXELS, PART_PIXELS = 4.0, 12.0
"""Pixels at which a Gaussian's own colours weigh as much as its part's, and those as all's."""
FLOOR = 0.02
"""Fraction of a distribution that is uniform over all colours."""
CLEAR = 0.1
"""Opacity below which a ray shows the background."""
MEMORY = 0.95
"""Fraction of the background's histogram that is kept from frame to frame."""
SEEN = 0.3
"""Visibility, summed over pixels, under which a Gaussian takes the colour of its part."""
_BLUR = (1.0, 0.8, 0.8)


@dataclass(frozen=True)
class ColourBins:
    """Bins of brightness and of two chromaticities that shading does not change."""

    values: int = 10
    chromas: int = 12
    """Bins of brightness, and of each chromaticity."""

    @property
    def count(self) -> int:
        """All bins."""
        return self.values * self.chromas**2

    def coordinates(self, hsv: Float[Array, "P 3"]) -> Float32[Array, "P 3"]:
        """Colours, given in hue, saturation and value from 0 to 1, in bins along the three axes."""
        hue, saturation, value = np.moveaxis(np.asarray(hsv, np.float32), -1, 0)
        reach = np.sqrt(saturation * value / (value + np.float32(DIM)))  # finer near grey
        angle = np.float32(2.0 * np.pi) * hue
        u, v = reach * np.cos(angle), reach * np.sin(angle)
        half = np.float32(self.chromas / 2)
        axes = (np.sqrt(value) * np.float32(self.values), (u + 1) * half, (v + 1) * half)
        return np.stack(axes, -1)

    def of(self, hsv: Float[Array, "P 3"]) -> Int32[Array, "P"]:
        """The bin of each colour."""
        return self.at(self.coordinates(hsv))

    def at(self, coordinates: Float32[Array, "P 3"]) -> Int32[Array, "P"]:
        """The bin at each of some `coordinates`."""
        top = (self.values - 1, self.chromas - 1, self.chromas - 1)
        row, first, second = np.clip(coordinates.astype(np.int32), 0, top).T
        return ((row * self.chromas + first) * self.chromas + second).astype(np.int32)

    def smooth(self, shares: Float[Array, "G K"]) -> Float[Array, "G K"]:
        """Histograms blurred over neighbouring bins, with an even floor."""
        from scipy.ndimage import gaussian_filter

        grid = shares.reshape(-1, self.values, self.chromas, self.chromas)
        blurred = gaussian_filter(grid, (0.0, *_BLUR), mode="nearest", truncate=2.5).reshape(
            shares.shape
        )
        return (1.0 - FLOOR) * blurred / blurred.sum(-1, keepdims=True) + FLOOR / self.count


BINS = ColourBins()
"""The bins of colours, where nothing else is said."""


@dataclass(frozen=True, eq=False)
class Palette:
    """The colours of a person's Gaussians."""

    log_density: Float32[Array, "G K"]  # of every Gaussian over `BINS`, of probabilities

    @classmethod
    def learn(
        cls,
        body: GaussianBody,
        seen: Sequence[Float32[Array, "P G"]],
        bins: Sequence[Int32[Array, "P"]],
    ) -> Palette:
        """From frames at known poses: visibility of every Gaussian along every ray, and bins.

        Raises InputError when there is no frame or none shows the body.
        """
        counts = ColourCounts(body)
        for visibility, at in zip(seen, bins, strict=True):
            counts.add(visibility, at)
        return cls(counts.log_density())


class ColourCounts:
    """How often each of a person's Gaussians was seen in each bin of colours."""

    def __init__(self, body: GaussianBody, bins: ColourBins = BINS) -> None:
        self.bins = bins
        self._counts = np.zeros((len(body.parts), bins.count))
        self._plain = np.array([without_side(part) for part in body.parts])

    @property
    def pixels(self) -> Float[Array, "G"]:
        """Pixels in which each Gaussian was seen, each by the square of its visibility there."""
        return self._counts.sum(1)

    def add(self, visibility: Float32[Array, "P G"], bins: Int32[Array, "P"],
            which: Bool[Array, "G"] | None = None) -> None:  # fmt: skip
        """Add a frame, given the bin of every ray; `which` Gaussians it is to count for."""
        sure = visibility.astype(float) ** 2
        counted = sure.sum(0) > 0.0
        for q in np.flatnonzero(counted if which is None else counted & which):
            self._counts[q] += np.bincount(bins, sure[:, q], self.bins.count)

    def log_density(self, which: Bool[Array, "G"] | None = None) -> Float32[Array, "g K"]:
        """Logarithm of the colours' probabilities, of all Gaussians or of some.

        Raises InputError if nothing was counted.
        """
        counts = self._counts
        if not counts.sum() > 0.0:
            raise InputError("no frame shows the body, so that its colours cannot be learned")
        everything = _shares(counts.sum(0))
        rows = np.arange(len(counts)) if which is None else np.flatnonzero(which)
        filled, parts = np.empty((len(rows), counts.shape[1])), {}
        for name in set(self._plain[rows]):
            part = counts[self._plain == name].sum(0)
            parts[name] = (part + PART_PIXELS * everything) / (part.sum() + PART_PIXELS)
        for row, q in zip(filled, rows, strict=True):
            part = parts[self._plain[q]]
            row[:] = (counts[q] + OWN_PIXELS * part) / (counts[q].sum() + OWN_PIXELS)
        return np.log(self.bins.smooth(filled)).astype(np.float32)


def learn_palette(
    body: GaussianBody,
    rays: ImageRays,
    frames: PosedFrames,
) -> Palette:
    """The colours of a body in frames of which images and pose are known.

    Raises InputError as `Palette.learn`.
    """
    model = ImageModel(body, rays)
    seen = [model.visibility(angles) for _, angles in frames]
    bins = [BINS.of(ray_colours(rays, images)) for images, _ in frames]
    return Palette.learn(body, seen, bins)


def colour_body(
    body: GaussianBody,
    rays: ImageRays,
    images: Sequence[UInt8[Array, "H W 3"]],
    angles: Float[Array, "37"],
) -> GaussianBody:
    """The body in the colours that one frame shows at a known pose.

    A Gaussian takes the mean of the pixels, each weighted by the square of how much of it is seen
    there: pixels that it fills, not those at its rim. One that is hidden takes its part's colour,
    or the same part's of the other side, or the mean of all.
    """
    weights = ImageModel(body, rays).visibility(angles) ** 2
    rgb = hsv_to_rgb(ray_colours(rays, images))
    mass, sums = weights.sum(0).astype(float), weights.T.astype(float) @ rgb
    colour = sums / np.maximum(mass, 1e-9)[:, None]
    names = np.array(body.parts)
    plain = np.array([without_side(part) for part in body.parts])
    for q in np.flatnonzero(mass < SEEN):
        for group in (names == names[q], plain == plain[q], np.ones(len(names), bool)):
            if mass[group].sum() >= SEEN:
                colour[q] = sums[group].sum(0) / mass[group].sum()
                break
    return body.with_colour(rgb_to_hsv(np.clip(colour, 0.0, 1.0)))


class Background:
    """The background's colours, updated from frame to frame."""

    def __init__(self, bins: ColourBins = BINS) -> None:
        self.bins = bins
        self._counts = np.zeros(bins.count)

    def update(self, bins: Int32[Array, "P"], opacity: Float32[Array, "P"]) -> None:
        """Add a frame whose rays the body covers by `opacity`."""
        new = np.bincount(bins[opacity < CLEAR], minlength=self.bins.count)
        self._counts = MEMORY * self._counts + (1.0 - MEMORY) * _shares(new)

    def density(self) -> Float[Array, "K"]:
        """The colours' probabilities."""
        return self.bins.smooth(_shares(self._counts)[None])[0]

    def compare(self, palette: Palette, bins: Int32[Array, "P"]) -> Palettes:
        """The rays' bins and every Gaussian's dissimilarity, for `ImageModel.evaluate`."""
        behind = np.log(self.density()).astype(np.float32)
        unlike = np.clip((behind - palette.log_density) / np.float32(LOG_RATIO), -1.0, 1.0)
        return Palettes(bins, np.ascontiguousarray(unlike, np.float32))


def _shares(counts: Float[Array, "K"]) -> Float[Array, "K"]:
    total = counts.sum()
    return counts / total if total > 0.0 else np.full(len(counts), 1.0 / len(counts))
