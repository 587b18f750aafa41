"""The page of a run: findings, certainty over time, path, worst moments as pictures, advice."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egocap.body.labels import LABEL_INDEX
from egocap.body.side_colours import LEFT, RIGHT
from egocap.data.sequence import Sequence
from egocap.data.track import CONTACTS, Track
from egocap.files import write_atomically
from egocap.motion_capture.findings import Findings
from egocap.view.skeleton import side_by_side

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{{ title }}</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem }
img, video { max-width: 100% } table { border-collapse: collapse; margin: .5rem 0 }
td, th { padding: .1rem 1rem .1rem 0; text-align: right; font-variant-numeric: tabular-nums }
td:first-child, th:first-child { text-align: left } figure { margin: 1rem 0 }
figcaption { color: #4b5563 } .low { color: #b91c1c; font-weight: 600 }
</style>
<h1>{{ title }}</h1>
<p>{{ facts }}</p>
<h2>What to improve</h2>
<ul>{% for line in advice %}<li>{{ line }}</li>{% endfor %}</ul>
{% if film %}<h2>Film</h2><video controls src="{{ film }}"></video>{% endif %}
<h2>Certainty over time</h2>
<img alt="certainty over time" src="data:image/png;base64,{{ course }}">
{% if path %}<h2>Path on the floor</h2>
<img alt="path of the head and footprints from above"
src="data:image/png;base64,{{ path }}">{% endif %}
<h2>Least certain moments</h2>
{% for caption, image in worst %}<figure><img alt="{{ caption }}"
src="data:image/jpeg;base64,{{ image }}"><figcaption>{{ caption }}</figcaption></figure>{% endfor %}
<h2>Joints</h2>
<table><tr><th>joint</th><th>recognised in any view</th><th>in any picture</th>
<th>standard deviation, median</th></tr>
{% for name, seen, inside, spread in joints %}<tr><td>{{ name }}</td>
<td{% if seen < 20 %} class="low"{% endif %}>{{ "%.0f" % seen }} %</td>
<td{% if inside < 20 %} class="low"{% endif %}>{{ "%.0f" % inside }} %</td>
<td>{{ "%.0f" % spread }} mm</td></tr>{% endfor %}</table>
<h2>Cameras</h2>
<table><tr><th>view</th><th>pictures</th><th>rate</th><th>dropped</th><th>repeated</th>
<th>damaged</th><th>black</th><th>clock</th></tr>
{% for name, view in views.items() %}<tr><td>{{ name }}</td><td>{{ "%.0f" % view.pictures }}</td>
<td>{{ "%.2f" % view.fps }} Hz</td><td>{{ "%.0f" % view.dropped }}</td>
<td>{{ "%.0f" % view.repeated }}</td><td>{{ "%.0f" % view.damaged }}</td>
<td>{{ "%.0f" % view.black }}</td><td>{{ "%+.1f" % view.offset_ms }} ms,
{{ "%+.0f" % view.drift_ppm }} ppm ({{ view.clock }})</td></tr>{% endfor %}</table>
{% if bones %}<h2>Body</h2>
<table><tr><th>bone to</th><th>length</th><th>standard deviation</th><th></th></tr>
{% for name, length, std, verdict in bones %}<tr><td>{{ name }}</td><td>{{ "%.0f" % length }} mm
</td><td>{{ "%.1f" % std }} %</td><td>{{ verdict }}</td></tr>{% endfor %}</table>{% endif %}
</html>
"""
_VERDICTS = {"well": "well determined", "badly": "badly determined",
             "prior": "not seen: population mean"}  # fmt: skip


def write_page(
    path: Path, sequence: Sequence, track: Track, found: Findings, bones: dict[str, Any],
    film: str | None,
) -> None:  # fmt: skip
    """Write the page, whole or not at all. `bones`: `BodyFit.report()`; empty for a given body."""
    import jinja2

    agreement = found.agreement
    facts = (
        f"{found.frames} frames, {found.seconds:.1f} s. A joint is within 5 cm with a probability "
        f"of {100 * float(found.sure.mean()):.0f} % on average. Rays of two views to the same "
        f"joint miss each other by {agreement.as_given:.2f} degrees in the median."
    )
    joints = [(name.replace("_", " "), 100 * found.seen[name], 100 * found.in_view[name],
               found.spread_mm[name]) for name in found.seen]  # fmt: skip
    lines = [
        (name.replace("left_", ""), 1e3 * bone["length_m"], bone["std_percent"],
         _VERDICTS[bone["determined"]])
        for name, bone in bones.items() if not name.startswith("right_")
    ]  # fmt: skip
    html = jinja2.Environment(autoescape=True).from_string(_PAGE).render(
        title=f"Motion of {sequence.folder.parent.name}", facts=facts, advice=found.advice,
        film=film, course=_course(track, found), worst=_moments(sequence, track, found),
        path=None if track.joints_world is None else _path(track), joints=joints,
        views=found.views, bones=lines,
    )  # fmt: skip
    write_atomically(path, html)


def _moments(sequence: Sequence, track: Track, found: Findings) -> list[tuple[str, str]]:
    """Captions and JPEG pictures of the least certain frames."""
    import simplejpeg

    assert track.confidence is not None
    shown = []
    for frame in found.worst:
        image = side_by_side(sequence.pictures(frame), track.joints_head[frame],
                             track.confidence[frame], sequence.rig)  # fmt: skip
        caption = (f"frame {frame}, {track.times[frame]:.2f} s: a joint is within 5 cm with a "
                   f"probability of {100 * found.sure[frame]:.0f} %")  # fmt: skip
        jpeg = simplejpeg.encode_jpeg(np.ascontiguousarray(image), 85)
        shown.append((caption, base64.b64encode(jpeg).decode()))
    return shown


def _course(track: Track, found: Findings) -> str:
    """Chart of the joints' certainty over time, PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    assert track.confidence is not None
    figure, axes = plt.subplots(figsize=(11.0, 2.6), dpi=90)
    for name, columns in {"arms": slice(2, 10), "legs": slice(10, 18)}.items():
        axes.plot(track.times, 100 * track.confidence[:, columns].mean(1), label=name, lw=1.0)
    axes.plot(track.times[found.worst], 100 * found.sure[found.worst], "v", color="#b91c1c",
              label="shown below")  # fmt: skip
    axes.set_xlabel("time [s]")
    axes.set_ylabel("within 5 cm [%]")
    axes.set_ylim(0, 102)
    axes.legend(loc="lower right", fontsize=9, ncols=3)
    axes.spines[["top", "right"]].set_visible(False)
    return _png(figure)


def _path(track: Track) -> str:
    """The head's path, without its gaps, and the planted feet from above, PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    assert track.T_world_head is not None and track.joints_world is not None
    known = np.ones(len(track.times), bool) if track.in_world is None else track.in_world
    head = np.where(known[:, None], track.T_world_head[:, :2, 3], np.nan)
    figure, axes = plt.subplots(figsize=(7.0, 5.0), dpi=90)
    axes.plot(*head.T, color="#4b5563", lw=1.2, label="head")
    for side, colour in (("left", LEFT), ("right", RIGHT)):
        toe = track.joints_world[:, LABEL_INDEX[f"{side}_foot"], :2]
        touches = known if track.contacts is None else (
            known & (track.contacts[:, CONTACTS.index(f"{side}_toe")] > 0.5))  # fmt: skip
        axes.plot(*toe[touches].T, "o", ms=3, alpha=0.5, mew=0, color=np.divide(colour, 255),
                  label=f"{side} foot on the ground")  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    return _png(figure)


def _png(figure: Figure) -> str:
    """A figure as base64 of a PNG; it is closed."""
    from matplotlib import pyplot as plt

    file = io.BytesIO()
    figure.savefig(file, format="png", bbox_inches="tight")
    plt.close(figure)
    return base64.b64encode(file.getvalue()).decode()
