"""What was found in imported footage, as text and as JSON-ready numbers."""

from __future__ import annotations

from typing import Any

from egocap.data.footage import FootageView
from egocap.data.sequence import Sequence

_LOST = ("dropped", "repeated", "damaged", "black")


def summary(sequence: Sequence) -> dict[str, Any]:
    """Frames, and for every view its pictures, clock and colours."""
    footage = sequence.footage
    assert footage is not None, sequence.folder
    views = {
        view.name: footage.report.get(view.name, {}) | {
            "path": view.path, "timing": view.timing.model_dump(),
            "colour": view.colour.model_dump(),
        }
        for view in footage.views
    }  # fmt: skip
    times = sequence.times
    return {"sequence": str(sequence.folder), "frames": len(sequence),
            "fps": sequence.manifest.fps, "start_s": float(times[0]), "end_s": float(times[-1]),
            "views": views}  # fmt: skip


def describe(sequence: Sequence) -> list[str]:
    """The same in lines of text."""
    footage = sequence.footage
    assert footage is not None, sequence.folder
    times = sequence.times
    lines = [f"{sequence.folder}: {len(sequence)} frames at {sequence.manifest.fps:g} Hz, "
             f"{times[0]:.2f} to {times[-1]:.2f} s"]  # fmt: skip
    for view in footage.views:
        found = footage.report.get(view.name, {})
        lost = ", ".join(f"{found[kind]:.0f} {kind}" for kind in _LOST if found.get(kind))
        missing = found.get("frames_without", 0)
        lines.append(
            f"  {view.name}: {found.get('pictures', 0):.0f} pictures at {found.get('fps', 0):g} Hz,"
            f" {lost or 'none lost'}; "
            f"{f'missing in {missing:.0f} frames' if missing else 'in every frame'}; "
            f"{_clock(view)}"
        )
    lines += _shorter(footage.report)
    return lines


def _clock(view: FootageView) -> str:
    timing = view.timing
    spread = "" if timing.offset_std_s is None else f" +- {1e3 * timing.offset_std_s:.1f}"
    return (f"clock {1e3 * timing.offset_s:+.1f}{spread} ms, {timing.drift_ppm:+.0f} ppm "
            f"({timing.origin}{f', {timing.note}' * bool(timing.note)})"
            f"{_colours(view)}")  # fmt: skip


def _colours(view: FootageView) -> str:
    if view.colour.origin == "assumed":
        return ""
    return f"; colours x {' '.join(f'{g:.2f}' for g in view.colour.gain)} ({view.colour.origin})"


def _shorter(report: dict[str, dict[str, float]]) -> list[str]:
    """A line for every view that ends or begins more than a second inside the others."""
    lines = []
    for name, found in report.items():
        last = max(other["last_s"] for other in report.values())
        first = min(other["first_s"] for other in report.values())
        if last - found["last_s"] > 1.0:
            lines.append(f"  {name} ends at {found['last_s']:.2f} s, {last - found['last_s']:.2f} s"
                         " before another view")  # fmt: skip
        if found["first_s"] - first > 1.0:
            lines.append(f"  {name} begins at {found['first_s']:.2f} s, "
                         f"{found['first_s'] - first:.2f} s after another view")  # fmt: skip
    return lines
