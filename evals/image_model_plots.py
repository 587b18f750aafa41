"""Pictures of the image model's studies: `python -m evals.image_model_plots RESULT.json OUT.png`.

Left: energy and slope while an arm sweeps before the trunk. Middle: error of both quadratures of
Eq. 4. Right: share of trials that return to under 30 mm from perturbed poses.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from evals.record import load_result


def draw(result: dict[str, Any], path: Path) -> None:
    """Draw the result of `evals.image_model` as PNG or SVG, by the suffix of `path`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16, 4.6), layout="constrained")
    sweep, quadrature, basin = figure.subplots(1, 3)
    _sweep(sweep, result["occlusion"])
    _quadrature(quadrature, result["quadrature"])
    _basin(basin, result["basin"])
    figure.savefig(path, dpi=110)


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


def _basin(axes: Any, found: dict[str, Any]) -> None:
    for name, entry in found.items():
        sizes = [int(k.split("_")[0]) for k in entry]
        shares = [100 * entry[f"{n}_deg"]["share_under_30_mm"] for n in sizes]
        axes.plot(sizes, shares, marker="o", label=name)
    axes.set(xlabel="perturbation of every angle, degrees", ylabel="back under 30 mm, %",
             title="basin of attraction", ylim=(-3, 103))  # fmt: skip
    axes.legend(fontsize=8)


def main() -> None:
    """Read a result and draw it."""
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    draw(load_result(Path(sys.argv[1]))["result"], Path(sys.argv[2]))


if __name__ == "__main__":
    main()
