"""The command that follows a tracked motion with a simulated body."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from egocap.commandline import DONE, progress
from egocap_sim.cli.registry import app, print_json

if TYPE_CHECKING:
    from egocap_sim.refinement.refine import Refinement


@app.command
def refine(
    track: Positional[Annotated[Path, arg(metavar="TRACK")]],
    out: Path,
    mass: float | None = None,
    residual: float = 0.3,
    forces: Path | None = None,
    json: bool = False,
) -> int:
    """Follow a tracked motion with a simulated body, on forces at its contacts.

    Makes a motion physically possible, as far as the residual allows, and says what it changes.
    Frames without a head pose, and those that nothing known bears, as on a bicycle, are kept.

    Args:
        track: track in the world, of `egocap track --head-pose`.
        out: track to write.
        mass: of the wearer in kg; default: of an average one with these bones.
        residual: standard deviation of the force that no contact explains, in body weights.
        forces: npz file for the force on every heel, toe, knee, hand and the seat.
        json: print what changed as JSON.
    """
    from egocap.data.track import load_track, save_track
    from egocap.errors import InputError
    from egocap_sim.refinement.control import ControlConfig
    from egocap_sim.refinement.refine import refine as follow
    from egocap_sim.refinement.report import save_forces, summary

    if not 0.01 <= residual <= 100.0:
        raise InputError(f"a residual of {residual:g} body weights", valid="0.01 to 100")
    tracked, config = load_track(track), ControlConfig(residual=residual)
    with progress("refine", 2 * len(tracked.times), unit="simulated frames") as advance:
        found = follow(tracked, mass, config, advance)
    save_track(out, found.track)
    if forces is not None:
        save_forces(forces, found)
    changes = summary(found)
    if json:
        print_json({"track": str(out), **changes})
    else:
        _print_changes(out, found, changes)
    return DONE


def _print_changes(out: Path, found: Refinement, changes: dict[str, float | None]) -> None:
    from egocap_sim.refinement.report import PARTS

    frames, refined = len(found.refined), int(found.refined.sum())
    print(f"{out}: {refined} of {frames} frames followed by a body of {found.mass_kg:.1f} kg")
    if refined < frames:
        print("the others are kept: no head pose, or borne by nothing known")
    if not refined:
        return
    print("joints moved by {moved_mm:.1f} mm (95 % {moved_95_mm:.1f}); residual force "
          "{residual_before:.2f} body weights as tracked, {residual:.2f} refined (95 % "
          "{residual_before_95:.2f}, {residual_95:.2f})".format(**changes))  # fmt: skip
    shares = (f"{part} {100 * (changes[part] or 0.0):.0f} %" for part in PARTS)
    print(f"weight borne by: {', '.join(shares)}")
