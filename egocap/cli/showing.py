"""Commands that show results: export, posterior, view, draw-model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional

from egocap.cli.checks import check_body, check_checkpoint
from egocap.cli.registry import app
from egocap.commandline import DONE
from egocap.detect.sources import detections_from
from egocap.errors import FileError, InputError
from egocap.locks import locks
from egocap.options import several
from egocap.posterior.config import PosteriorConfig, SamplerConfig

MOST_DRAWS = 2_000_000
"""Of a chain of the posterior, which is kept in memory."""


@app.command
@locks("out")
def export(
    track: Positional[Path],
    out: Path,
    format: Literal["bvh", "glb", "usda", "c3d", "trc", "csv", "npz", "smpl", "coco"] | None = None,
) -> int:
    """Write a track, or detections, for other programs.

    bvh: a skeleton from the hips for Blender and other animation tools; metres, y up.
    glb, usda: a skinned figure with its animation (glTF 2.0, USD); metres, y up, facing z.
    c3d: the joints as markers; millimetres, z up, x forward.
    trc: the joints as markers for OpenSim; millimetres, y up, x forward.
    csv: a row a frame, joints in metres and angles in degrees; npz: plain arrays with names.
    smpl: pose parameters of SMPL-X in AMASS's layout (npz), without shape; metres, z up.
    coco: of detections, keypoint results (json), images numbered as by `egocap-sim export`.
    Tracks are in the world if the track was made with --head-pose, else relative to a fixed head.

    Args:
        track: track, or detections, to read, npz.
        out: file to write.
        format: what to write; by default the suffix of the file tells, .smpl.npz for smpl.
    """
    from egocap.data.detections import load_detections
    from egocap.data.track import load_track
    from egocap.export.coco import write_coco
    from egocap.export.formats import FORMATS, format_of

    if track.is_dir():
        raise FileError(track, "a folder", valid="a track or detections, npz")
    if format == "coco" or (format is None and out.suffix == ".json"):
        detections = load_detections(track)
        write_coco(out, detections)
        print(f"{out}: {len(detections.times)} frames")
        return DONE
    name = format_of(out) if format is None else format
    found = load_track(track)
    FORMATS[name](out, found)
    print(f"{out}: {len(found.times)} frames")
    return DONE


@app.command
@locks("out", "page", "checkpoint")
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
    body: str | None = None,
    stated_errors: bool = False,
    json: bool = False,
) -> int:
    """Sample the posterior of the pose in one frame: uncertainty of every joint.

    A chain that has not converged is saved with a warning. At most the limit of steps is made;
    most chains stop far earlier.

    Args:
        sequence: folder of a sequence.
        out: posterior to write, npz.
        frame: frame of the sequence, from 0.
        detections: where detections come from, as for `egocap track`; their noise has seed 0.
        config: prior, and noise of the detections.
        sampling: length of the chain.
        page: page of figures to write, html.
        checkpoint: file to save the chain in, npz; the same command continues an interrupted run.
        colour: include the image colours in the likelihood, learned from the sequence's own track;
            takes minutes.
        body: the person's proportions, as for track.
        stated_errors: take the learned detector's standard deviations as stated, with the settings'
            degrees and temperature, instead of the model of its errors.
        json: print the summary as JSON.
    """
    import json as jsons

    from egocap.commandline import progress
    from egocap.data.sequence import Sequence
    from egocap.fitting.wearer import find_body
    from egocap.posterior.detector_error import with_error_model
    from egocap.posterior.frame_posterior import sample_posterior
    from egocap.posterior.result import save_posterior

    if sampling.walkers * sampling.most_steps > MOST_DRAWS:
        raise InputError(f"{sampling.walkers} walkers of {sampling.most_steps} steps",
                         valid=f"{MOST_DRAWS:,} draws or fewer")  # fmt: skip
    if page is not None and page.suffix not in (".html", ".htm"):
        raise InputError(f"--page {page}", valid="the name of an .html file")
    opened = Sequence(sequence)
    if not 0 <= frame < len(opened):
        raise InputError(f"no frame {frame} in {sequence}", valid=f"0 to {len(opened) - 1}")
    if body is None:
        _ = opened.body  # or refuse now
    check_body(body)
    check_checkpoint(checkpoint)
    found = detections_from(opened, detections, 0)
    if not stated_errors:
        found, config = with_error_model(found, config)
    if body is not None:
        opened.body = find_body(body, opened.rig, found)
    with progress("sampling", sampling.most_steps, unit="steps") as advance:
        result = sample_posterior(
            opened, frame, found, config, sampling, checkpoint=checkpoint, colour=colour,
            on_steps=advance,
        )  # fmt: skip
    save_posterior(out, result)
    if page is not None:
        from egocap.posterior.figures import write_page

        write_page(page, result, opened.rig, opened.frame(frame).images)
    summary = result.summary()
    if json:
        print(jsons.dumps(summary, indent=1))
        return DONE
    ends = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")
    spread = ", ".join(f"{j.replace('_', ' ')} {summary['spread_mm'][j]} mm" for j in ends)
    print(f"{out}: {result.outcome}; {result.steps} steps in {summary['seconds']} s; "
          f"spread {spread}")  # fmt: skip
    for note in result.notes:
        print(note)
    return DONE


@app.command
def view(
    what: Positional[Annotated[tuple[Path, ...], several("PATH")]],
    save: Path | None = None,
    images: bool = True,
) -> int:
    """Look at a motion in three dimensions, over its images and as curves.

    Opens the Rerun viewer (pip install 'egocap[view]'), or writes a file that `rerun FILE` and
    rerun.io/viewer open. Left is blue, right vermilion, the truth grey; ellipsoids are two standard
    deviations, yellow marks feet that stand.

    Args:
        what: a sequence, tracks to compare (npz), posteriors (npz), head poses with the points of
            the surroundings (npz, of egocap head-pose) beside tracks in their world, a rig file.
        save: file to write instead of opening the viewer: .rrd, or .mp4, a film in its layout of a
            sequence and a track, which needs no extra.
        images: include the images of the sequence; a film always has them.
    """
    from egocap.view.viewer import view as show

    if not what:
        raise InputError(
            "nothing to show", valid="a sequence, tracks, posteriors, head poses or a rig file"
        )
    show(what, save, images)
    if save is not None:
        how = f"; open it with: rerun {save}" * (save.suffix == ".rrd")
        print(f"{save}: {save.stat().st_size / 1e6:.1f} MB{how}")
    return DONE


@app.command
def draw_model(
    sequence: Positional[Path],
    out: Path,
    frame: int = 0,
    track: Path | None = None,
    gaussians: Path | None = None,
    size: tuple[int, int] = (256, 256),
) -> int:
    """Draw the image model of one frame.

    Image, rendered density, visibility of the Gaussians, colour dissimilarity and energy of
    every pixel. Without a track, the pose is the one nearest to a simulated sequence's truth.

    Args:
        sequence: folder of a sequence.
        out: picture to write, png.
        frame: frame of the sequence, from 0.
        track: track whose pose to draw, npz.
        gaussians: volumetric body to draw, json; by default one coloured by the frame itself.
        size: width and height at which a view is evaluated, pixels.
    """
    from egocap.commandline import progress
    from egocap.view.render import view_model

    with progress("draw-model", 0):
        summary = view_model(sequence, frame, out, track, gaussians, size)
    print(f"{out}: energy {summary['energy']:.1f}, {summary['covered_pixels']:.0f} pixels covered")
    return DONE
