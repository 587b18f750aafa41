"""Slow changes of the light in brightness and tint, estimated from the person's pixels.

A person's colours are learned once; clouds, lamps and rooms change. Light that changes brightness
and temperature multiplies every colour channel (von Kries), in gamma-coded values too, as a power
of a product is a product. The factors are measured at pixels that show a known part: the
centres of Gaussians that nothing covers. Their median is robust to a
limb in a wrong place, and is followed slowly. Images are divided by it before colours are compared,
so that the person's colours and the background's stay what they were.

Source: von Kries 1902 (diagonal adaptation); EgoCap 2016 has fixed colours.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.special import erf

from egocap.body.gaussians import GaussianBody
from egocap.cameras.rig import Rig
from egocap.image_model.body_kernel import gaussian_centres
from egocap.image_model.colour_measure import hsv_to_rgb
from egocap.image_model.image_rays import ImageRays, PosedFrames, ray_colours, ray_numbers
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import BINS, Palette

RATE = 0.15
"""Fraction of the measured change that is applied in a frame: faster changes are filtered out."""
LARGEST, AT_FIRST = 1.5, 4.0
"""Factor on a channel of a pixel, from one frame to the next, beyond which the pose is wrong there
and not the light; and against another stretch of footage."""
LEAST = 12
"""Pixels under which nothing is learned from a frame."""
CLEAR = 0.3
"""Optical depth before a Gaussian's centre up to which it counts as visible."""
DARK, BRIGHT = 0.06, 0.96
"""Values of a channel outside which its ratio is unreliable: noise and clipping."""


class Illumination:
    """Factors of the present light on red, green and blue, against that of the learned colours."""

    def __init__(self, body: GaussianBody, rig: Rig, rays: ImageRays) -> None:
        self.gain: Float[Array, "3"] = np.ones(3)
        self._body, self._rig = body, rig.resized(*rays.size)
        self._known = np.full((len(body.parts), 3), np.nan)  # RGB at gain 1
        self._index = ray_numbers(rays)
        parts = np.array(body.parts)
        self._foreign = parts[:, None] != parts  # those of a part run into each other

    def learn(self, hsv: Float[Array, "P 3"], angles: Float[Array, "37"]) -> None:
        """Learn the person's colours from those along the rays, divided by the present gain.

        Gaussians known from frames before stay as they are, so that all are in the same light.
        """
        which, pixels = self._plain(angles)
        new = np.isnan(self._known[which, 0])
        self._known[which[new]] = hsv_to_rgb(hsv[pixels[new]])

    def update(
        self,
        hsv: Float[Array, "P 3"],
        angles: Float[Array, "37"],
        rate: float = RATE,
        largest: float = LARGEST,
    ) -> int:
        """Update the gain from a frame whose colours along the rays were divided by it.

        Returns the number of pixels used; with too few the gain stays. A pixel that
        changed by more than a factor of `largest` shows something else.
        """
        which, pixels = self._plain(angles)
        found, known = hsv_to_rgb(hsv[pixels]) * self.gain, self._known[which]
        told = ((found > DARK) & (found < BRIGHT) & (known > DARK)).all(1)
        change = np.log(found[told] / known[told]) - np.log(self.gain)
        change = change[np.abs(change).max(1, initial=0.0) < np.log(largest)]
        if len(change) >= LEAST:
            self.gain = self.gain * np.exp(rate * np.median(change, axis=0))
        return len(change)

    def initialise(self, hsv: Float[Array, "P 3"], angles: Float[Array, "37"]) -> int:
        """As `follow`, for a frame that does not follow the last: its light is taken as it is."""
        return self.update(hsv, angles, 1.0, AT_FIRST)

    def _plain(self, angles: Float[Array, "37"]) -> tuple[Int[Array, "N"], Int[Array, "N"]]:
        """Gaussians whose centres are plainly seen, and the rays that show them."""
        body, rig = self._body, self._rig
        centres = gaussian_centres(np.asarray(angles, float)[None], body)[0]
        eyes = rig.T_head_camera[:, :3, 3]
        pixels, inside = rig.project(centres)  # (V, G, 2), (V, G)
        spot = np.rint(np.where(inside[..., None], pixels, 0.0)).astype(int)
        height, width = self._index.shape[1:]
        column, row = np.clip(spot[..., 0], 0, width - 1), np.clip(spot[..., 1], 0, height - 1)
        ray = self._index[np.arange(len(eyes))[:, None], row, column]
        sure = inside & (ray >= 0)
        for v, eye in enumerate(eyes):
            sure[v] &= self._depths(centres, eye) < CLEAR
        view, which = np.nonzero(sure)
        return which, ray[view, which]

    def _depths(self, centres: Float[Array, "G 3"], eye: Float[Array, "3"]) -> Float[Array, "G"]:
        """Optical depth of other parts between an eye and every centre: equation 4."""
        arm = centres - eye
        length = np.linalg.norm(arm, axis=1)
        direction = arm / np.maximum(length, 1e-6)[:, None]
        middle = direction @ arm.T  # (centre looked at, Gaussian passed)
        across = (arm**2).sum(1) - middle**2
        sigma, root = self._body.sigma, np.sqrt(2.0) * self._body.sigma
        share = 0.5 * (erf((length[:, None] - middle) / root) - erf(-middle / root))
        depth = self._body.density * sigma * np.sqrt(2.0 * np.pi)
        return (depth * np.exp(-0.5 * across / sigma**2) * share * self._foreign).sum(1)


def learn_in_light(
    body: GaussianBody, rig: Rig, rays: ImageRays,
    frames: PosedFrames,
) -> tuple[Palette, Illumination]:  # fmt: skip
    """The colours of a body in frames of known pose, as in the light of the first of them.

    As `palette.learn_palette`, but the frames may differ in their light. Raises InputError as
    `Palette.learn`.
    """
    light, bins = Illumination(body, rig, rays), []
    for images, angles in frames:
        light.gain = np.ones(3)
        light.initialise(ray_colours(rays, images), angles)
        hsv = ray_colours(rays, images, light.gain)
        light.learn(hsv, angles)
        bins.append(BINS.of(hsv))
    model = ImageModel(body, rays)
    seen = [model.visibility(angles) for _, angles in frames]
    light.gain = np.ones(3)
    return Palette.learn(body, seen, bins), light
