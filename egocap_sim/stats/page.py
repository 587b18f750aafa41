"""Summarise statistics as numbers and as one self-contained HTML page."""

from __future__ import annotations

from collections import Counter
from importlib.resources import files
from typing import Any

import numpy as np

from egocap.body.labels import LABELS
from egocap_sim.stats.collect import CAUSES, Statistics

_ROWS_SHOWN = 200


def summary(stats: Statistics) -> dict[str, Any]:
    """The numbers of the page, as JSON values. Shares are percentages."""
    heights = [p["height_m"] for p in stats.persons.values() if "height_m" in p]
    total = stats.total
    share = 100 * total / total.sum(1, keepdims=True)
    images = total[0].sum()  # every image counts a joint once
    return {
        "sequences": len(stats.rows),
        "frames": stats.frames,
        "seconds": sum(row.seconds for row in stats.rows),
        "bytes": sum(row.bytes for row in stats.rows),
        "people": len(stats.persons),
        "height_m": [min(heights), float(np.mean(heights)), max(heights)] if heights else None,
        **{f"{key}s": _tally(stats, key) for key in ("rig", "place", "motion", "sensor")},
        "dropped_images": 100 * stats.dropped / images,
        "joints": {
            label: dict(zip((c.replace(" ", "_") for c in CAUSES), share[j].tolist(), strict=True))
            | {
                "seen_by_any": float(100 * stats.seen_by_any[j] / stats.frames),
                "spread_cm": float(100 * stats.spread_m[j]),
            }
            for j, label in enumerate(LABELS)
        },
    }


def render_page(stats: Statistics) -> str:
    """Render the page as HTML with embedded charts."""
    from jinja2 import Environment, StrictUndefined

    from egocap_sim.stats.charts import draw

    template = (files("egocap_sim.stats") / "page.html").read_text(encoding="utf-8")
    page = Environment(autoescape=True, undefined=StrictUndefined).from_string(template)
    charts = draw(stats)
    return page.render(
        numbers=summary(stats),
        charts=charts,
        heat={view: charts[f"heat {view}"] for view in stats.heat},
        rows=stats.rows[:_ROWS_SHOWN],
        more=len(stats.rows) - _ROWS_SHOWN,
    )


def _tally(stats: Statistics, key: str) -> dict[str, int]:
    """Number of sequences with each value of a column, in descending order."""
    return dict(Counter(filter(None, (getattr(row, key) for row in stats.rows))).most_common())
