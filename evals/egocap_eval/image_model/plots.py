"""Figures of the image model's studies.

OUT.png: energy and slope while an arm sweeps before the trunk; error of both quadratures of Eq. 4;
scatter of the stochastic gradient; share of trials that return to under 30 mm from perturbed poses.
OUT-angles.png: energy along every angle about the true pose.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

COLUMNS = 8
KINDS = {"colour": "tab:orange", "with_detections": "tab:blue"}


def draw(result: dict[str, Any], path: Path) -> tuple[Path, Path]:
    """Draw the result of `image_model.study`; returns the paths written (png or svg, by suffix)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 9.5), layout="constrained")
    (sweep, quadrature), (scatter, basin) = figure.subplots(2, 2)
    _sweep(sweep, result["occlusion"])
    _quadrature(quadrature, result["quadrature"])
    _scatter(scatter, result["stochastic"])
    _basin(basin, result["basin"])
    figure.savefig(path, dpi=90)
    angles = path.with_name(f"{path.stem}-angles{path.suffix}")
    _valleys(result["valleys"]).savefig(angles, dpi=80)
    return path, angles


def _sweep(axes: Any, found: dict[str, Any]) -> None:
    axes.plot(found["angle_deg"], found["energy"], color="tab:blue")
    axes.set(xlabel="shoulder rotation, degrees", ylabel="colour energy",
             title="an arm sweeps before the trunk")  # fmt: skip
    slope = axes.twinx()
    slope.plot(found["angle_deg"], found["slope"], color="tab:orange", linewidth=1)
    slope.set_ylabel("slope by the kernel, per radian", color="tab:orange")


def _quadrature(axes: Any, found: dict[str, Any]) -> None:
    """Work is points along a ray for 91 Gaussians: samples each, or cells over 2.6 m."""
    for i, (name, entry) in enumerate(found.items()):
        samples = [int(k.split("_")[1]) for k in entry if k.startswith("samples_")]
        axes.semilogy(samples, [entry[f"samples_{n}"]["relative"] for n in samples],
                      color=f"C{i}", marker="o", label=name)  # fmt: skip
        axes.axhline(entry["cells_20mm"]["relative"], color=f"C{i}", linewidth=0.8, linestyle=":")
    axes.set(xlabel="samples a Gaussian (dotted: cells of 2 cm)", ylabel="relative error",
             title="Eq. 4 against brute force")  # fmt: skip
    axes.legend(fontsize=8)


def _scatter(axes: Any, found: dict[str, Any]) -> None:
    points = [k.split("_") for k in found if k.startswith("rays_")]
    for i, keep in enumerate(sorted({p[3] for p in points}, key=float)):
        rays = sorted({int(p[1]) for p in points})
        for name, style in (("scatter", "-"), ("scatter_even", ":")):
            shares = [found[f"rays_{n}_keep_{keep}"][name] for n in rays]
            label = f"{keep} of the Gaussians" if name == "scatter" else None
            axes.loglog(rays, shares, f"C{i}o{style}", label=label)
    axes.set(xlabel="rays a step (dotted: drawn evenly)", ylabel="scatter / full gradient",
             title="the stochastic gradient about the full one")  # fmt: skip
    axes.legend(fontsize=8)


def _valleys(found: dict[str, Any]) -> Any:
    """A panel an angle: energies of every scene, each scaled to 1 at its highest."""
    from matplotlib.figure import Figure

    names, offsets = found["angles"], found["offset_deg"]
    rows = -(-len(names) // COLUMNS)
    figure = Figure(figsize=(2.1 * COLUMNS, 1.75 * rows), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, sharex=True).ravel()
    for d, (axes, name) in enumerate(zip(panels, names, strict=False)):
        for kind, colour in KINDS.items():
            for i, scene in enumerate(found["scenes"].values()):
                curve = scene[kind][d]
                highest = max(*curve, 1e-9)
                label = kind.replace("_", " ") if i == 0 else None
                axes.plot(offsets, [e / highest for e in curve], color=colour, linewidth=1,
                          alpha=0.8, label=label)  # fmt: skip
        axes.axvline(0.0, color="0.7", linewidth=0.8, zorder=0)
        axes.set_title(name.replace("_", " "), fontsize=8)
        axes.set_yticks([])
        axes.tick_params(labelsize=7)
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    panels[-1].legend(handles, labels, fontsize=8, loc="center")
    figure.suptitle("energy along each angle, degrees from the truth; a line a scene", fontsize=10)
    return figure


def _basin(axes: Any, found: dict[str, Any]) -> None:
    for name, entry in found.items():
        sizes = [int(k.split("_")[0]) for k in entry]
        shares = [100 * entry[f"{n}_deg"]["share_under_30_mm"] for n in sizes]
        axes.plot(sizes, shares, marker="o", label=name)
    axes.set(xlabel="perturbation of every angle, degrees", ylabel="back under 30 mm, %",
             title="basin of attraction", ylim=(-3, 103))  # fmt: skip
    axes.legend(fontsize=8)
