"""Figures of a posterior, and an HTML page that holds them."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS, LIMBS
from egocap.body.side_colours import side_hex
from egocap.cameras.rig import Rig
from egocap.files import make_folder, write_atomically
from egocap.posterior.result import Posterior

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHELL = 2.796
"""Radius in standard deviations of the ellipsoid that holds 95 % of a 3-D Gaussian."""
_FAN = 60
_TRACES = 24


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
<p{% if not converged %} class="bad"{% endif %}>{{ outcome }}</p>
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
    summary = posterior.summary()
    drawn = [
        ("Ellipsoids", draw_ellipsoids(posterior)),
        ("Fan", draw_fan(posterior, rig, images)),
        ("Corner", draw_corner(posterior)),
        ("Traces", draw_traces(posterior)),
    ]
    config, rhat = posterior.config, summary["largest_rhat"]
    facts = (
        f"{posterior.steps} steps of {posterior.draws.shape[0]} walkers in {summary['seconds']} s, "
        f"acceptance {summary['acceptance']}, largest R-hat {rhat}, {summary['least_effective']} "
        f"effective draws or more, shares of the modes "
        f"{summary['mode_shares']}; detections {config.get('detections')}, rig {config.get('rig')}."
    )
    spread = [
        (name.replace("_", " "), value, summary["laplace_spread_mm"][name])
        for name, value in summary["spread_mm"].items()
    ]
    write_pictures(
        path, f"Posterior of frame {posterior.frame}", drawn, facts=facts, spread=spread,
        converged=posterior.converged, outcome=posterior.outcome, notes=posterior.notes,
    )  # fmt: skip


def write_pictures(
    path: Path,
    title: str,
    drawn: Sequence[tuple[str, Figure]],
    *,
    facts: str = "",
    spread: Sequence[tuple[str, float, float]] = (),
    converged: bool = True,
    outcome: str = "",
    notes: Sequence[str] = (),
) -> None:
    """Write a page of named figures, whole or not at all."""
    import jinja2

    template = jinja2.Environment(autoescape=True).from_string(_PAGE)
    html = template.render(
        title=title, facts=facts, spread=spread, converged=converged, outcome=outcome, notes=notes,
        pictures=[(name, _png(figure)) for name, figure in drawn],
    )  # fmt: skip
    make_folder(path.parent)
    write_atomically(path, html.encode())


def draw_ellipsoids(posterior: Posterior) -> Figure:
    """The mean pose from the front and from the side, 95 % ellipses of every joint."""
    figure, panels = _figure(1, 2, (9.0, 6.5))
    mean, covariance = posterior.joint_mean, posterior.joint_covariance
    for axes, across, name in zip(panels, (1, 0), ("from the front", "from the left"), strict=True):
        sign = -1.0 if across == 1 else 1.0  # from the front, the person's left is on the right
        plane, signs = [across, 2], np.array([-sign, 1.0])
        for a, b in LIMBS:
            ends = mean[[a, b]][:, plane] * signs
            axes.plot(*ends.T, color=_limb_colour(a, b), lw=1.5, alpha=0.8)
        for j, label in enumerate(LABELS):
            block = covariance[j][np.ix_(plane, plane)] * np.outer(signs, signs)
            axes.add_patch(_ellipse(mean[j, plane] * signs, block, _label_colour(label)))
        axes.set_aspect("equal")
        axes.set_title(name)
        axes.set_xlabel("metres")
    panels[0].set_ylabel("up of the skull base, metres")
    figure.suptitle("Mean pose and 95 % regions of the joints")
    return figure


def draw_fan(
    posterior: Posterior, rig: Rig, images: Sequence[UInt8[Array, "H W 3"]] | None = None
) -> Figure:
    """Sampled poses over every view's image, black where there is none."""
    figure, panels = _figure(1, len(rig.mounts), (6.0 * len(rig.mounts), 5.2))
    rng = np.random.default_rng(0)
    poses = posterior.flat_joints
    chosen = poses[rng.choice(len(poses), min(_FAN, len(poses)), replace=False)]
    pixels, valid = rig.project(chosen)  # (V, B, 18, 2)
    for v, axes in enumerate(panels):
        camera = rig.cameras[v]
        image = (
            np.zeros((camera.height, camera.width, 3), np.uint8) if images is None else images[v]
        )
        axes.imshow(image)
        for points, seen in zip(pixels[v], valid[v], strict=True):
            for a, b in LIMBS:
                if seen[a] and seen[b]:
                    axes.plot(*points[[a, b]].T, color=_limb_colour(a, b), lw=0.7, alpha=0.35)
        axes.set_xlim(0, camera.width)
        axes.set_ylim(camera.height, 0)
        axes.set_axis_off()
        axes.set_title(rig.views[v])
    figure.suptitle(f"{len(chosen)} poses drawn from the posterior")
    return figure


def draw_corner(posterior: Posterior) -> Figure:
    """Histograms of the five least certain angles, alone and in pairs."""
    names = _least_certain(posterior, 5)
    columns = [posterior.names.index(name) for name in names]
    values = np.rad2deg(posterior.flat[:, columns])
    n = len(names)
    figure, panels = _figure(n, n, (1.9 * n, 1.9 * n), squeeze=False)
    ranges = [tuple(np.quantile(values[:, i], (0.001, 0.999))) for i in range(n)]
    for r in range(n):
        for c in range(n):
            axes = panels[r * n + c]
            if c > r:
                axes.set_axis_off()
                continue
            if c == r:
                axes.hist(values[:, c], bins=40, range=ranges[c], color="#64748b")
            else:
                axes.hist2d(values[:, c], values[:, r], bins=40, cmap="Blues",
                            range=(ranges[c], ranges[r]))  # fmt: skip
            axes.tick_params(labelsize=6, labelbottom=r == n - 1, labelleft=c == 0 and r > 0)
            if r == n - 1:
                axes.set_xlabel(names[c].replace("_", " "), fontsize=7)
            if c == 0 and r > 0:
                axes.set_ylabel(names[r].replace("_", " "), fontsize=7)
    figure.suptitle("Least certain angles, degrees")
    return figure


def draw_traces(posterior: Posterior) -> Figure:
    """Walkers over time and autocorrelation, of the three slowest parameters."""
    slowest = np.argsort(posterior.effective)[:3]
    figure, panels = _figure(3, 2, (9.0, 6.0))
    for row, i in enumerate(slowest):
        left, right = panels[2 * row], panels[2 * row + 1]
        name = posterior.names[i]
        factor, unit = _shown(name)
        left.plot(factor * posterior.draws[:_TRACES, :, i].T, lw=0.4, alpha=0.7)
        left.set_ylabel(name.replace("_", "\n") + f",\n{unit}", fontsize=7)
        function = _autocorrelation(posterior.draws[..., i])
        every = (posterior.steps - posterior.burn_in) / posterior.draws.shape[1]
        right.plot(np.arange(len(function)) * every, function, color="#0f766e")
        right.axhline(0.0, color="#9ca3af", lw=0.7)
    panels[0].set_title(f"{len(posterior.draws[:_TRACES])} walkers")
    panels[1].set_title("autocorrelation")
    panels[-2].set_xlabel("kept draw")
    panels[-1].set_xlabel("steps")
    return figure


def draw_reliability(
    curves: Mapping[str, tuple[Float[Array, "L"], Float[Array, "L"], Float[Array, "L"]]],
) -> Figure:
    """Share of truths inside regions against the share they should hold.

    Each curve has nominal levels, coverages and the half length of their error bars, 0 to 1.
    """
    figure, (axes,) = _figure(1, 1, (5.0, 5.0))
    axes.plot([0, 1], [0, 1], color="#9ca3af", lw=1, label="calibrated")
    for name, (nominal, found, error) in curves.items():
        axes.errorbar(nominal, found, yerr=error, marker="o", ms=3, capsize=2, lw=1, label=name)
    axes.set_xlabel("nominal share of the region")
    axes.set_ylabel("share of true joints inside")
    axes.set_aspect("equal")
    axes.legend()
    return figure


def _figure(rows: int, columns: int, size: tuple[float, float], **more: Any) -> Any:
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=size, layout="constrained")
    panels = figure.subplots(rows, columns, **more)
    return figure, list(np.ravel(panels))


def _ellipse(centre: Float[Array, "2"], covariance: Float[Array, "2 2"], colour: str) -> Any:
    from matplotlib.patches import Ellipse

    values, vectors = np.linalg.eigh(covariance)
    width, height = 2.0 * SHELL * np.sqrt(np.maximum(values, 0.0))
    angle = np.rad2deg(np.arctan2(vectors[1, 0], vectors[0, 0]))
    return Ellipse(tuple(centre), width, height, angle=angle, color=colour, alpha=0.35, lw=0)


def _least_certain(posterior: Posterior, count: int) -> list[str]:
    spread = posterior.flat[:, :37].std(0)
    return [posterior.names[i] for i in np.argsort(-spread)[:count]]


def _shown(name: str) -> tuple[float, str]:
    """Factor from a parameter's unit to the one in which it is drawn, and that unit."""
    if name.startswith("scale_"):
        return 100.0, "100 ln"
    if name.rpartition("_")[0].endswith("_shift"):
        return 1e3, "mm"
    return float(np.rad2deg(1.0)), "degrees"


def _autocorrelation(draws: Float[Array, "W S"]) -> Float[Array, "L"]:
    from emcee.autocorr import function_1d

    with np.errstate(invalid="ignore"):
        return np.nanmean([function_1d(walker) for walker in draws], axis=0)[: draws.shape[1] // 2]


def _label_colour(label: str) -> str:
    return side_hex(label)


def _limb_colour(a: int, b: int) -> str:
    return _label_colour(LABELS[b] if LABELS[a] in ("head", "neck") else LABELS[a])


def _png(figure: Figure) -> str:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return base64.b64encode(file.getvalue()).decode()
