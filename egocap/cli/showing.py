"""Commands that look at results: export, posterior, view."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional

from egocap.cli.registry import app
from egocap.commandline import DONE
from egocap.detect.sources import detections_from
from egocap.posterior.config import PosteriorConfig, SamplerConfig


@app.command
def export(
    track: Positional[Path],
    out: Path,
    format: Literal["bvh", "npz"] = "bvh",
) -> int:
    """Write a track for other programs.

    bvh opens in Blender and other animation tools: metres, y up, the skeleton from the hips. npz
    holds plain arrays with the joints' names. Both are in the world where the track was made with
    --head-pose, else about a head that stays where it is.

    Args:
        track: track to read, npz.
        out: file to write.
        format: what to write.
    """
    from egocap.data.bvh import write_bvh
    from egocap.data.track import load_track, write_arrays

    found = load_track(track)
    {"bvh": write_bvh, "npz": write_arrays}[format](out, found)
    print(f"{out}: {len(found.times)} frames")
    return DONE


@app.command
def posterior(
    sequence: Positional[Path],
    out: Path,
    frame: int,
    detections: str = "learned",
    config: Annotated[PosteriorConfig, tyro.conf.OmitArgPrefixes] = PosteriorConfig(),  # noqa: B008
    sampling: Annotated[SamplerConfig, tyro.conf.OmitArgPrefixes] = SamplerConfig(),  # noqa: B008
    page: Path | None = None,
    checkpoint: Path | None = None,
    colour: bool = False,
    json: bool = False,
) -> int:
    """Sample what one frame's detections say about the pose: how sure it is, joint by joint.

    A chain that has not mixed is written all the same, and said to be so.

    Args:
        sequence: folder of a sequence.
        out: posterior to write, npz.
        frame: frame of the sequence, from 0.
        detections: where detections come from, as for `egocap track`; their noise has seed 0.
        config: what is believed before the detections, and how they scatter.
        sampling: how long to sample.
        page: page of pictures to write, html.
        checkpoint: chain to keep, npz; the same command takes up a killed run from it.
        colour: let the images' colours speak, too, learned from the sequence's own track: minutes.
        json: print the summary as JSON.
    """
    import json as jsons

    from egocap.data.sequence import Sequence
    from egocap.posterior.run import write_posterior

    opened = Sequence(sequence)
    found = detections_from(opened, detections, 0)
    told = write_posterior(
        opened, found, frame, out, config, sampling, page=page, checkpoint=checkpoint, colour=colour
    )
    if json:
        print(jsons.dumps(told, indent=1))
        return DONE
    ends = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")
    hands = ", ".join(f"{j.replace('_', ' ')} {told['spread_mm'][j]} mm" for j in ends)
    print(f"{out}: {told['outcome']}; {told['steps']} steps in {told['seconds']} s; spread {hands}")
    for note in told["notes"]:
        print(note)
    return DONE


@app.command
def view(
    what: Positional[Literal["model"]],
    sequence: Positional[Path],
    out: Path,
    frame: int = 0,
    track: Path | None = None,
    gaussians: Path | None = None,
    size: tuple[int, int] = (256, 256),
) -> int:
    """Draw what the method makes of one frame.

    model: image, rendered density, visibility of the Gaussians, colour dissimilarity and energy of
    every pixel. Without a track, the pose is the one nearest to a simulated sequence's truth.

    Args:
        what: what to draw.
        sequence: folder of a sequence.
        out: picture to write, png.
        frame: frame of the sequence, from 0.
        track: track whose pose to draw, npz.
        gaussians: volumetric body to draw, json; by default one coloured by the frame itself.
        size: width and height at which a view is evaluated, pixels.
    """
    from egocap.view.render import view_model

    summary = view_model(sequence, frame, out, track, gaussians, size)
    print(f"{out}: energy {summary['energy']:.1f}, {summary['covered_pixels']:.0f} pixels covered")
    return DONE
