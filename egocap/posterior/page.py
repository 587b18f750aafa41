"""One HTML file with all pictures of a posterior in it."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.files import make_folder, write_atomically
from egocap.posterior import plots
from egocap.posterior.result import Posterior
from egocap.posterior.run import summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{{ title }}</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }
img { max-width: 100% } table { border-collapse: collapse } td, th { padding: .1rem .8rem .1rem 0;
text-align: right } td:first-child, th:first-child { text-align: left }
.bad { color: #b91c1c; font-weight: 600 }
</style>
<h1>{{ title }}</h1>
<p{% if not mixed %} class="bad"{% endif %}>{{ outcome }}</p>
{% for note in notes %}<p>{{ note }}</p>{% endfor %}
<p>{{ facts }}</p>
{% for name, picture in pictures %}<h2>{{ name }}</h2>
<img alt="{{ name }}" src="data:image/png;base64,{{ picture }}">{% endfor %}
{% if spread %}<h2>Spread of the joints, mm</h2>
<table><tr><th>joint</th><th>sampled</th><th>Laplace</th></tr>
{% for name, sampled, laplace in spread %}<tr><td>{{ name }}</td><td>{{ sampled }}</td>
<td>{{ laplace }}</td></tr>{% endfor %}</table>{% endif %}
</html>
"""


def write_page(
    path: Path, posterior: Posterior, rig: Rig, images: Sequence[UInt8[Array, "H W 3"]] | None
) -> None:
    """Draw a posterior and write the page, whole or not at all."""
    told = summary(posterior)
    drawn = [
        ("Ellipsoids", plots.draw_ellipsoids(posterior)),
        ("Fan", plots.draw_fan(posterior, rig, images)),
        ("Corner", plots.draw_corner(posterior)),
        ("Traces", plots.draw_traces(posterior)),
    ]
    facts = (
        f"{told['steps']} steps of {posterior.draws.shape[0]} walkers in {told['seconds']} s, "
        f"acceptance {told['acceptance']}, longest autocorrelation time "
        f"{told['longest_autocorrelation']} steps, largest R-hat {told['largest_rhat']}, shares of "
        f"the modes {told['mode_shares']}; detections {posterior.config.get('detections')}, rig "
        f"{posterior.config.get('rig')}."
    )
    spread = [
        (name.replace("_", " "), value, told["laplace_spread_mm"][name])
        for name, value in told["spread_mm"].items()
    ]
    write_pictures(
        path, f"Posterior of frame {posterior.frame}", drawn, facts=facts, spread=spread,
        mixed=posterior.mixed, outcome=posterior.outcome, notes=posterior.notes,
    )  # fmt: skip


def write_pictures(
    path: Path,
    title: str,
    drawn: Sequence[tuple[str, Figure]],
    *,
    facts: str = "",
    spread: Sequence[tuple[str, float, float]] = (),
    mixed: bool = True,
    outcome: str = "",
    notes: Sequence[str] = (),
) -> None:
    """Write a page of named figures, whole or not at all."""
    import jinja2

    template = jinja2.Environment(autoescape=True).from_string(_PAGE)
    html = template.render(
        title=title, facts=facts, spread=spread, mixed=mixed, outcome=outcome, notes=notes,
        pictures=[(name, _png(figure)) for name, figure in drawn],
    )  # fmt: skip
    make_folder(path.parent)
    write_atomically(path, html.encode())


def _png(figure: Figure) -> str:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return base64.b64encode(file.getvalue()).decode()
