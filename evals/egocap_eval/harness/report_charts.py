"""The report's charts as inline SVG, drawn with text that stays text."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy import ndarray as Array

_INK, _QUIET = "#22262b", "#8a929c"
COLORS = ("#3b6ea8", "#d98032", "#5a9a68", "#8b5fa8", "#b5495b", "#6b7680", "#c2a83e", "#3f9aa8")
_STYLE = {
    "font.size": 9, "font.family": "sans-serif", "axes.edgecolor": _QUIET, "axes.labelcolor": _INK,
    "text.color": _INK, "xtick.color": _INK, "ytick.color": _INK, "axes.spines.top": False,
    "axes.spines.right": False, "axes.titlesize": 9, "svg.hashsalt": "egocap",
    "svg.fonttype": "none", "lines.linewidth": 1.4,
}  # fmt: skip
_SMOOTHEST = 400  # points of a line at most


def lines(
    series: Mapping[str, tuple[Float[Array, "N"], Float[Array, "N"]]],
    *,
    x: str,
    y: str,
    title: str,
    size: tuple[float, float] = (8.6, 2.6),
    limits: tuple[float, float] | None = None,
) -> str:
    """Lines by name over a common axis; long ones are thinned by their maxima."""
    with rc_context(_STYLE):  # pyright: ignore[reportArgumentType]
        figure, axes = _figure(size)
        for (name, (at, values)), color in zip(series.items(), _cycle(len(series)), strict=True):
            axes.plot(*_thinned(at, values), color=color, label=name)
        axes.set(xlabel=x, ylabel=y, title=title)
        axes.set_ylim(bottom=0)
        if limits is not None:
            axes.set_ylim(*limits)
        if len(series) > 1:
            axes.legend(frameon=False, fontsize=8, ncols=min(len(series), 4))
        return _svg(figure, title)


def bars(
    groups: Sequence[str],
    series: Mapping[str, Sequence[float | None]],
    *,
    y: str,
    title: str,
    size: tuple[float, float] = (8.6, 2.9),
) -> str:
    """Bars of every series side by side for each group; a missing value leaves a gap."""
    with rc_context(_STYLE):  # pyright: ignore[reportArgumentType]
        figure, axes = _figure(size)
        width = 0.8 / max(len(series), 1)
        for i, ((name, values), color) in enumerate(
            zip(series.items(), _cycle(len(series)), strict=True)
        ):
            at = np.arange(len(groups)) + (i - (len(series) - 1) / 2) * width
            heights = [np.nan if value is None else value for value in values]
            axes.bar(at, heights, width, color=color, label=name)
        axes.set_xticks(range(len(groups)), groups, rotation=45, ha="right")
        axes.set(ylabel=y, title=title)
        if len(series) > 1:
            axes.legend(frameon=False, fontsize=8, ncols=min(len(series), 4))
        return _svg(figure, title)


def _cycle(count: int) -> list[str]:
    return [COLORS[i % len(COLORS)] for i in range(count)]


def _thinned(at: Array, values: Array) -> tuple[Array, Array]:
    step = -(-len(values) // _SMOOTHEST)
    if step == 1:
        return at, values
    cut = len(values) // step * step
    return at[:cut:step], np.nanmax(values[:cut].reshape(-1, step), axis=1)


def _figure(size: tuple[float, float]) -> tuple[Figure, Axes]:
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots()


def _svg(figure: Figure, title: str) -> str:
    """The figure as an <svg> element that scales with the page."""
    content = io.StringIO()
    figure.savefig(content, format="svg", metadata={"Date": None, "Title": title})
    text = content.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', 'role="img"', text, count=1)
    return re.sub(r"font: ([\d.]+)px [^;\"]+", r"font: \1px system-ui, sans-serif", text)
