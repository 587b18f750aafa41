"""Charts of the statistics page, as SVG."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.body.side_colours import side_hex
from egocap_sim.stats.collect import (
    ANGLES,
    CAUSES,
    FORCE_MOST,
    HAND_BINS,
    REACH_M,
    Statistics,
)  # fmt: skip

_INK, _QUIET = "#22262b", "#8a929c"
_BAR, _SECOND = "#3b6ea8", "#d98032"
_SIDES = side_hex("left"), side_hex("right")
_CAUSE_COLORS = ("#3b6ea8", "#d9dde2", "#d98032", "#8b5fa8")
_STYLE = {
    "font.size": 9, "axes.edgecolor": _QUIET, "axes.labelcolor": _INK, "text.color": _INK,
    "xtick.color": _INK, "ytick.color": _INK, "axes.spines.top": False,
    "axes.spines.right": False, "axes.titlesize": 9, "svg.hashsalt": "egocap",
}  # fmt: skip


def visibility(figure: Figure, stats: Statistics) -> None:
    """Draw the shares of visible, occluded and out of view of each joint; a dot for any view."""
    total = stats.total
    share = 100 * total / total.sum(1, keepdims=True)
    axes = figure.subplots()
    left = np.zeros(len(LABELS))
    order = (0, 2, 3, 1)  # visible, both kinds of occlusion, out of view
    for cause in order:
        axes.barh(_NAMES, share[:, cause], left=left, color=_CAUSE_COLORS[cause],
                  label=CAUSES[cause], height=0.78)  # fmt: skip
        left += share[:, cause]
    axes.plot(100 * stats.seen_by_any / stats.frames, _NAMES, "o", color=_INK, markersize=4,
              label="seen by at least one camera")  # fmt: skip
    axes.set(xlim=(0, 100), xlabel="% of images")
    axes.invert_yaxis()
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)


def heat_maps(figure: Figure, stats: Statistics, view: str) -> None:
    """Draw image-position histograms of each joint in view."""
    grid = figure.subplots(3, 6)
    for axes, name, heat in zip(grid.flat, _NAMES, stats.heat[view], strict=True):
        axes.imshow(np.sqrt(heat), cmap="magma", interpolation="nearest", aspect="equal")
        axes.set_title(name, fontsize=8)
        axes.set(xticks=[], yticks=[])


def people(figure: Figure, stats: Statistics) -> None:
    """Draw histograms of height, age and mass of the distinct people."""
    first, second, third = figure.subplots(1, 3)
    people_ = list(stats.persons.values())
    for axes, key, bins, label in (
        (first, "height_m", np.arange(1.40, 2.11, 0.05), "height, m"),
        (second, "age_years", np.arange(15, 96, 5), "age, years"),
        (third, "mass_kg", np.arange(30, 151, 7.5), "mass, kg"),
    ):
        by_sex = [[p[key] for p in people_ if p.get("sex") == sex and key in p]
                  for sex in ("female", "male")]  # fmt: skip
        axes.hist(by_sex, bins, stacked=True, color=[_SECOND, _BAR], label=["female", "male"])
        axes.set(xlabel=label)
    first.set_ylabel("people")
    first.legend(frameon=False, fontsize=8)


def hands(figure: Figure, stats: Statistics) -> None:
    """Draw hand positions from above and from the left; the cross is the head."""
    grid = figure.subplots(1, 4)
    low = -2 * REACH_M + 0.4
    titles = [f"{side} hand, {how}" for side in ("left", "right")
              for how in ("from above", "from the side")]  # fmt: skip
    for axes, title, counts in zip(
        grid, titles, stats.hands.reshape(4, HAND_BINS, HAND_BINS), strict=True
    ):
        above = "above" in title
        if above:  # forward is up, left is left
            picture, extent = counts[:, ::-1], (REACH_M, -REACH_M, -REACH_M, REACH_M)
        else:
            picture, extent = counts.T, (-REACH_M, REACH_M, low, 0.4)
        axes.imshow(np.sqrt(picture), cmap="magma", origin="lower", extent=extent, aspect="equal")
        axes.plot(0, 0, "+", color="white")
        axes.set_title(title)
        axes.set(xlabel="m to the left" if above else "m forward")
    grid[0].set_ylabel("m forward")
    grid[1].set_ylabel("m up")


def angles(figure: Figure, stats: Statistics) -> None:
    """Draw histograms of joint angles."""
    grid = figure.subplots(1, len(ANGLES) // 2)
    edges = np.linspace(0, 180, stats.angles.shape[1] + 1)
    for i, axes in enumerate(grid):
        for counts, name, color in zip(
            stats.angles[2 * i : 2 * i + 2], ("left", "right"), _SIDES, strict=True
        ):
            axes.stairs(_percent(counts), edges, color=color, label=name)
        axes.set_title(ANGLES[2 * i].split(" ", 1)[1])
        axes.set(xlim=(0, 180), xticks=(0, 60, 120, 180), xlabel="degrees")
    grid[0].set_ylabel("% of frames")
    grid[0].legend(frameon=False, fontsize=8)


def contacts(figure: Figure, stats: Statistics) -> None:
    """Draw foot contacts and the ground force."""
    first, second, third = figure.subplots(1, 3)
    first.bar(("none", "left", "right", "both"), _percent(stats.stance),
              color=(_QUIET, *_SIDES, _QUIET))  # fmt: skip
    first.set(ylabel="% of frames", title="feet on the ground")
    names = ("left foot", "left toe", "right foot", "right toe")
    second.barh(names, 100 * stats.contact / stats.frames,
                color=[side_hex(name.replace(" ", "_")) for name in names])  # fmt: skip
    second.invert_yaxis()
    second.set(xlim=(0, 100), title="% of frames in contact")
    third.stairs(_percent(stats.force), np.linspace(0, FORCE_MOST, len(stats.force) + 1),
                 color=_BAR, fill=True)  # fmt: skip
    third.set(title="ground force, body weights", xlim=(0, FORCE_MOST))


CHARTS: dict[str, tuple[float, Callable[[Figure, Statistics], None]]] = {
    "people": (2.3, people),
    "hands": (2.5, hands),
    "angles": (2.3, angles),
    "visibility": (4.6, visibility),
    "contacts": (2.2, contacts),
}
"""Name in the page's template: height in inches, and the function that draws the chart."""

_NAMES = [label.replace("_", " ") for label in LABELS]


def draw(stats: Statistics) -> dict[str, str]:
    """Draw every chart as an SVG data URL, by name, and 'heat VIEW' for each view."""
    with rc_context(_STYLE):  # pyright: ignore[reportArgumentType]
        charts = {name: _svg(height, chart, stats) for name, (height, chart) in CHARTS.items()}
        return charts | {f"heat {view}": _svg(4.0, heat_maps, stats, view) for view in stats.heat}


def _svg(height: float, chart: Callable[..., None], *arguments: object) -> str:
    figure = Figure(figsize=(8.6, height), layout="constrained")
    chart(figure, *arguments)
    content = io.BytesIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(content.getvalue()).decode()


def _percent(counts: Array) -> Float[Array, "n"]:
    return 100 * counts / max(counts.sum(), 1)
