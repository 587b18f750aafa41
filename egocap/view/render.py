"""From files to pictures: what `egocap draw-model` runs."""

from __future__ import annotations

from pathlib import Path

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.data.sequence import Sequence
from egocap.data.track import load_track
from egocap.errors import FileError, InputError
from egocap.pose.inverse_kinematics import nearest_angles
from egocap.view.model import draw_model

SIZES = (16, 1024)


def view_model(
    folder: Path,
    frame: int,
    out: Path,
    track: Path | None,
    gaussians: Path | None,
    size: tuple[int, int],
) -> dict[str, float]:
    """Draw the image model on a frame; returns its energy and the pixels it covers.

    Raises InputError and FileError for frames, files and sizes that do not fit.
    """
    if out.suffix != ".png":
        raise InputError(f"--out {out}: no format for '{out.suffix}'", valid=".png")
    if not all(SIZES[0] <= side <= SIZES[1] for side in size):
        raise InputError(f"--size {size[0]} {size[1]}", valid=f"{SIZES[0]} to {SIZES[1]} pixels")
    sequence = Sequence(folder)
    if not 0 <= frame < len(sequence):
        raise InputError(f"no frame {frame} in {folder}", valid=f"0 to {len(sequence) - 1}")
    if track is None:
        if not sequence.manifest.truth:
            raise InputError(f"{folder} is footage, whose pose is not known", valid="--track FILE")
        angles = nearest_angles(sequence.body, sequence.truth.joints_head[frame])
    else:
        found = load_track(track)
        if len(found.times) != len(sequence):
            raise FileError(track, f"has {len(found.times)} frames, the sequence {len(sequence)}")
        angles = found.angles[frame]
        if not sequence.manifest.truth and found.offsets is not None:
            sequence.body = Proportions(found.offsets)
    body = GaussianBody.load(gaussians) if gaussians is not None else None
    return draw_model(sequence, frame, angles, out, body, *size)
