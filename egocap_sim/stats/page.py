"""One self-contained HTML page of what a set of sequences contains."""

from __future__ import annotations

from collections import Counter
from importlib.resources import files
from typing import Any

import numpy as np

from egocap.body.labels import LABELS
from egocap_sim.stats.collect import CAUSES, Statistics

_ROWS_SHOWN = 200


def summary(stats: Statistics) -> dict[str, Any]:
    """The numbers of the page, JSON-ready. Shares are percentages."""
    heights = [p["height_m"] for p in stats.persons.values() if "height_m" in p]
    total = stats.total
    share = 100 * total / total.sum(1, keepdims=True)
    images = stats.frames * len(stats.causes)
    return {
        "sequences": len(stats.rows),
        "frames": stats.frames,
        "seconds": sum(row.seconds for row in stats.rows),
        "bytes": sum(row.bytes for row in stats.rows),
        "people": len(stats.persons),
        "height_m": [min(heights), float(np.mean(heights)), max(heights)] if heights else None,
        "rigs": _tally(row.rig for row in stats.rows),
        "places": _tally(row.place for row in stats.rows),
        "motions": _tally(row.motion for row in stats.rows),
        "sensors": _tally(row.sensor for row in stats.rows),
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
    """The page as HTML; it needs nothing beside itself."""
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


def _tally(values: Any) -> dict[str, int]:
    """How many sequences have each value, the commonest first."""
    return dict(Counter(value for value in values if value).most_common())
