"""One picture of the volumetric image model on one frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.data.sequence import Sequence
from egocap.errors import MachineError
from egocap.image_model.colour_measure import ColourMeasure, hsv_to_rgb
from egocap.image_model.image_rays import ImageRays, image_rays, ray_colours, ray_image
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import colour_body

PANELS = ("image", "density", "model colours", "most visible part", "dissimilarity", "pixel energy")
_VOID = 0.12
"""Grey of pixels without a ray or without a body."""


def draw_model(
    sequence: Sequence,
    frame: int,
    angles: Float[Array, "37"],
    out: Path,
    body: GaussianBody | None = None,
    width: int = 256,
    height: int = 256,
    measure: ColourMeasure = ColourMeasure(),  # noqa: B008 (frozen)
) -> dict[str, float]:
    """Write image, density, visibility, dissimilarity and energy of a pose as one PNG.

    One row a view. Below them the visibility of each of the Gaussians, in pixels. Without a `body`,
    an average one takes its colours from this frame at this pose. Returns what the title says.
    Raises MachineError when the picture cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    images = sequence.frame(frame).images
    rays = image_rays(sequence.rig, width, height)
    if body is None:
        body = GaussianBody.from_proportions(sequence.body)
        body = colour_body(body, rays, images, angles)
    seen = ImageModel(body, rays).visibility(angles)
    unlike = _dissimilarities(body, rays, images, measure)
    opacity, energy = seen.sum(1), (seen * unlike).sum(1)
    panels = _panels(body, rays, images, seen, unlike)

    rows = len(rays.origins)
    figure = plt.figure(figsize=(4.0 * len(PANELS), 4.2 * rows + 3.2), dpi=80)
    grid = figure.add_gridspec(rows + 1, len(PANELS), height_ratios=[4.0] * rows + [2.2])
    for view in range(rows):
        for column, (name, (planes, style)) in enumerate(zip(PANELS, panels, strict=True)):
            axes = figure.add_subplot(grid[view, column])
            drawn = axes.imshow(planes[view], **style)
            axes.set_axis_off()
            axes.set_title(f"{name}, {sequence.rig.views[view]}", fontsize=14)
            if style.get("cmap"):
                figure.colorbar(drawn, ax=axes, fraction=0.046, pad=0.02)
    _bars(figure.add_subplot(grid[rows, :]), body, seen, rays)
    summary = {"energy": float(energy.sum()), "covered_pixels": float(opacity.sum())}
    figure.suptitle(
        f"{sequence.manifest.name}, frame {frame}: energy {summary['energy']:.0f}, "
        f"{summary['covered_pixels']:.0f} pixels covered", fontsize=18,
    )  # fmt: skip
    figure.tight_layout()
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(out)
    except OSError as error:
        raise MachineError(f"cannot write {out}: {error.strerror}") from None
    finally:
        plt.close(figure)
    return summary


def _dissimilarities(body, rays, images, measure):
    features = measure.features(ray_colours(rays, images))
    return measure.compare(body.colour.astype(np.float32), features[:, None])


def _panels(
    body: GaussianBody, rays: ImageRays, images, seen, unlike
) -> tuple[tuple[Array, dict[str, Any]], ...]:
    """Planes (V, H, W[, 3]) and how to draw them, in the order of `PANELS`."""
    opacity, energy = seen.sum(1), (seen * unlike).sum(1)
    share = seen / np.maximum(opacity, 1e-9)[:, None]
    names = sorted(set(body.parts))
    part = np.array([names.index(p) for p in body.parts])[seen.argmax(1)]
    image = hsv_to_rgb(ray_colours(rays, images))
    model = seen @ hsv_to_rgb(body.colour) + (1.0 - opacity[:, None]) * _VOID
    faint = opacity < 0.05
    between = np.where(faint, np.nan, (share * unlike).sum(1))
    signed = {"cmap": "coolwarm", "vmin": -1.0, "vmax": 1.0}
    return (
        (np.clip(ray_image(rays, image, _VOID), 0, 1), {}),
        (ray_image(rays, opacity), {"cmap": "gray", "vmin": 0.0, "vmax": 1.0}),
        (np.clip(ray_image(rays, model, _VOID), 0, 1), {}),
        (ray_image(rays, np.where(faint, np.nan, part)), {"cmap": "tab20"}),
        (ray_image(rays, between), signed),
        (ray_image(rays, energy), signed),
    )


def _bars(axes, body: GaussianBody, seen, rays: ImageRays) -> None:
    """Visibility of every Gaussian, summed over the pixels of each view."""
    places = np.arange(len(body.parts))
    bottom = np.zeros(len(places))
    for view in range(len(rays.origins)):
        mass = seen[rays.view == view].sum(0)
        axes.bar(places, mass, bottom=bottom, label=f"view {view}", width=0.9)
        bottom += mass
    starts = [i for i, p in enumerate(body.parts) if i == 0 or p != body.parts[i - 1]]
    axes.set_xticks(starts, [body.parts[i] for i in starts], rotation=40, ha="right", fontsize=11)
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_ylabel("visibility, pixels")
    axes.legend(loc="upper right")
