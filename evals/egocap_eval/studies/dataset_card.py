"""The card of a data set: its contents, and the minimum requirements that it misses."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from tyro.conf import Positional, arg

from egocap.body.labels import LABELS
from egocap.errors import InputError
from egocap.evaluation.table import Table
from egocap_eval.harness.study import Outcome

if TYPE_CHECKING:
    from egocap.cameras.rig import Rig

LEAST_SEEN = 35.0  # percent of the frames in which some camera of a rig sees a joint
LEAST_PEOPLE = 200
LEAST_FRAMES = 20_000
REACHED = 0.5  # a rig reaches a joint that is inside a lens in this share of a sequence


def study(
    folder: Positional[Annotated[Path, arg(metavar="DIR")]],
    page: Annotated[Path | None, arg(metavar="FILE")] = None,
) -> Outcome:
    """Count a data set's people, rigs, places and motions, and how often joints are visible.

    Args:
        folder: Data set in episodes, or folder of sequences.
        page: HTML page of the statistics to write.
    """
    from egocap.commandline import progress
    from egocap.data.dataset import find_sequences
    from egocap.data.sequence import Sequence
    from egocap.data.truth import VISIBLE
    from egocap_eval.harness.result_file import write_text
    from egocap_sim.stats.collect import Statistics
    from egocap_sim.stats.page import render_page, summary

    if page is not None and page.suffix != ".html":
        raise InputError(f"--page {page}: no format for '{page.suffix}'", valid=".html")
    found, statistics = find_sequences([folder]), Statistics()
    able, seen = np.zeros(len(LABELS)), np.zeros(len(LABELS))
    lengths, reaches, lenses = [], [], []
    with progress("sequences", len(found), unit="sequences") as advance:
        for path in found:
            statistics.add(path)
            sequence = Sequence(path)
            truth = sequence.truth
            reached = truth.in_view.any(1).mean(0) >= REACHED
            frames = len(truth.time)
            able += frames * reached
            seen += reached * (truth.visibility == VISIBLE).any(1).sum(0)
            lengths.append(frames)
            reaches.append(reached)
            lenses.append(_lenses(sequence.true_rig))
            advance(1)
    result = summary(statistics)
    result["episode_frames"] = [min(lengths), float(np.mean(lengths)), max(lengths)]
    for j, label in enumerate(LABELS):
        result["joints"][label] |= {
            "reached": float(100 * able[j] / statistics.frames),
            "seen_where_reached": float(100 * seen[j] / able[j]) if able[j] else None,
        }
    result["seldom_seen"] = seldom_seen(result, np.array(reaches), np.array(lenses))
    if page is not None:
        write_text(page, render_page(statistics))
    tables = [_table(result), _joints(result)]
    if result["seldom_seen"]:
        title = f"Seen in under {LEAST_SEEN:g} % of the frames"
        tables.append(Table(title, ("joint", "why"), tuple(result["seldom_seen"].items())))
    return Outcome(result, tables, missed(result))


def _lenses(rig: Rig) -> tuple[float, float]:
    """Field of view of a rig's lenses, degrees, and their distance ahead of the head, cm."""
    across = min(2.0 * np.degrees(camera.max_angle) for camera in rig.cameras)
    return across, 100 * float(np.mean([m.T_head_camera[0, 3] for m in rig.mounts]))


def seldom_seen(
    result: dict[str, Any], reached: Bool[Array, "S 18"], lenses: Float[Array, "S 2"]
) -> dict[str, str]:
    """Joints that no camera sees in `LEAST_SEEN` percent of the frames, and why in numbers.

    `reached`: joints that the rig of each of S sequences has in view. `lenses`: their field of
    view (degrees) and distance ahead of the head (cm).
    """
    found = {}
    for j, label in enumerate(LABELS):
        row = result["joints"][label]
        if row["seen_by_any"] >= LEAST_SEEN:
            continue
        why = (
            f"{row['seen_by_any']:.1f} % seen; "
            f"of the images it is outside the lens in {row['out_of_view']:.1f} %, "
            f"behind the wearer in {row['hidden_by_the_wearer']:.1f} %, "
            f"behind others in {row['hidden_by_others']:.1f} %"
        )
        for which, those in (("reach it", reached[:, j]), ("do not", ~reached[:, j])):
            if those.any():
                across, ahead = np.median(lenses[those], axis=0)
                why += f"; {those.sum()} rigs {which} (median {across:.0f} degrees, {ahead:.0f} cm)"
        if row["seen_where_reached"] is not None:
            why += f"; {row['seen_where_reached']:.1f} % seen with those that do"
        found[label] = why
    return found


def missed(result: dict[str, Any]) -> list[str]:
    """Requirements that the data set misses."""
    short = [
        f"{label} is seen in {row['seen_where_reached']:.1f} % of the frames of rigs that reach it"
        for label, row in result["joints"].items()
        if row["seen_by_any"] < LEAST_SEEN
        and row["seen_where_reached"] is not None
        and row["seen_where_reached"] < LEAST_SEEN
    ]
    if result["people"] < LEAST_PEOPLE:
        short.append(f"{result['people']} people, not {LEAST_PEOPLE}")
    if result["frames"] < LEAST_FRAMES:
        short.append(f"{result['frames']} frames, not {LEAST_FRAMES}")
    return short


def _table(result: dict[str, Any]) -> Table:
    keys = ("frames", "sequences", "people", "seconds", "bytes", "dropped_images")
    rows = [[key.replace("_", " "), f"{result[key]:g}"] for key in keys]
    for key in ("height_m", "episode_frames"):
        if result[key]:
            low, mean, high = result[key]
            rows.append([key.replace("_", " "), f"{low:.3g} to {high:.3g}, mean {mean:.3g}"])
    for key in ("rigs", "motions"):
        rows.append([key, ", ".join(f"{n} {name}" for name, n in list(result[key].items())[:12])])
    return Table("Data set", ("what", "how much"), tuple((what, much) for what, much in rows))


def _joints(result: dict[str, Any]) -> Table:
    rows = [(label, f"{row['seen_by_any']:.1f}", f"{row['reached']:.1f}",
             "-" if row["seen_where_reached"] is None else f"{row['seen_where_reached']:.1f}")
            for label, row in result["joints"].items()]  # fmt: skip
    head = ("joint", "seen by a camera %", "frames of rigs that reach it %", "seen in those %")
    return Table("Joints", head, tuple(rows))
