"""The tables of motion capture from camera files, of the head's path, and of adaptation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from egocap_eval.evidence.page_table import Results, markdown, number, plus_minus

_FILES = {"captures-validation.json": "validation", "captures-test.json": "test"}
_WALKS = {"covered": "covered: the same, lenses covered for 10 s",
          "consumer": "consumer: half a minute with a rolling shutter and blur",
          "street": "street: 10 s between buildings, two people walking by",
          "stairs": "stairs: 10 s up a stair on a sports field"}  # fmt: skip


def captures(results: Results) -> str:
    """Clocks, errors, speed and memory of motion capture from exported camera files."""
    header = ("footage", "s", "lag error, ms", "drift error, ppm", "lost unreported",
              "joint error, mm", "known clocks", "head's path, mm", "up, deg", "floor, mm",
              "frames/s", "CPU ms a frame", "MB")  # fmt: skip
    rows = [row for file, label in _FILES.items()
            for row in results.rows(file, label, _captures)]  # fmt: skip
    rows += results.rows("capture-memory.json", "30 minutes", _memory)
    return markdown(header, rows, results)


def head_path(results: Results) -> str:
    """Where the head is in the world, by the odometry, against the truth."""
    header = ("walk", "frames with a pose", "path, m", "position, mm rms", "largest, mm",
              "rotation, degrees rms", "at the end, % of the path", "up, degrees", "height, mm",
              "CPU ms a frame")  # fmt: skip
    return markdown(header, results.rows("head_pose.json", "cases", _walks), results)


def adapted(results: Results) -> str:
    """Accuracy of a plain world's detector before and after adaptation to another camera."""
    header = ("wearer, pictures", "PCK@20 visible", "adapted", "PCK@20 in view", "adapted")
    return markdown(header, results.rows("adapt.json", "adaptation", _adapted), results)


def _adapted(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    pictures = {"harsh": "as adapted to", "clean": "of the plain world"}
    for row in (*result["rows"], {"person": "mean", **result["mean"]}):
        for case, label in pictures.items():
            before, after = row[case], row[f"{case}, adapted"]
            yield (f"{row['person']}, {label}",
                   *(number(scores[f"pck20_{kind}"]) for kind in ("visible", "in_view")
                     for scores in (before, after)))  # fmt: skip


def _walks(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    offline = ((_WALKS.get(str(name), str(name)), row) for name, row in result["cases"].items())
    live = ((f"{name}, live", row) for name, row in result.get("live", {}).items())
    for label, row in (*offline, *live):
        stated = row.get("vertical", {})
        yield (
            label, f"{row['posed']} of {row['frames']}", number(row.get("path_m"), 0),
            number(row.get("first_aligned_mm")), number(row.get("worst_mm")),
            number(row.get("rotation_deg"), 3), number(row.get("drift_percent"), 3),
            plus_minus(row.get("up_error_deg"), stated.get("up_std_deg"), 2),
            plus_minus(row.get("height_error_mm"), stated.get("floor_std_mm")),
            number(row.get("cpu_ms_per_frame"), 0),
        )  # fmt: skip


def _captures(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    for name, row in result["cases"].items():
        yield (
            f"{result['set']}: {name}", number(row["seconds"], 0),
            plus_minus(row["lag_error_ms"], row["lag_std_ms"], 2),
            plus_minus(row["drift_error_ppm"], row["drift_std_ppm"], 0), str(row["unreported"]),
            number(row["mocap_mm"]), number(row["known_sync_mm"]),
            number(row["all_aligned_mm"], 2), plus_minus(row["up_error_deg"], row["up_std_deg"], 2),
            plus_minus(row["height_error_mm"], row["floor_std_mm"]),
            number(row["frames_per_second"]), number(row["cpu_ms_per_frame"], 0),
            number(row["peak_mb"], 0),
        )  # fmt: skip


def _memory(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    most = max(result["rows"], key=lambda row: row["frames"])
    label = f"30 minutes, extrapolated from {most['frames']} frames of {result['size'][0]} x "
    yield (f"{label}{result['size'][1]}", "1800", *9 * ("-",),
           number(most["cpu_ms_per_frame"], 0), number(result["mb_of_30_minutes"], 0))  # fmt: skip
