"""Commands of rigs: rig convert, rig check, rig show, correct-rig, fit-rig."""

from __future__ import annotations

import json as jsons
import re
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional, arg

from egocap.cli.registry import app
from egocap.commandline import DONE, MISSED, progress
from egocap.detect.sources import detections_from
from egocap.errors import InputError
from egocap.fitting.config import FitConfig
from egocap.locks import locks, require_distinct

if TYPE_CHECKING:
    from egocap.cameras.rig import Rig
    from egocap.fitting.fit_rig import RigFit

FORMATS = ("rig", "kalibr", "opencv", "opencv-xml", "colmap", "aria", "ros", "ocam", "unrealego")
_LARGEST_SIDE, _LONGEST_NAME, _MOST_POSES = 1 << 16, 40, 100_000
_BY_SUFFIX = {".toml": "rig", ".xml": "opencv-xml"}


@dataclass(frozen=True)
class Convert:
    """Convert calibrations: Kalibr, OpenCV, OCamCalib, COLMAP, Project Aria, UnrealEgo, ROS, rigs.

    The input's format is told by its content. Formats of one camera make a file for each view.
    """

    source: Positional[Path]
    """Rig file or calibration file."""
    out: Positional[Path]
    """File to write."""
    format: str | None = None
    """rig, kalibr, opencv, opencv-xml, colmap, aria, ros, ocam or unrealego; by default from the
    suffix (.toml, .xml) or, for .json, rig."""
    mount: Annotated[
        tuple[float, float, float, float, float, float] | None,
        arg(metavar="FORWARD LEFT UP PITCH YAW ROLL"),
    ] = None
    """Place of the first camera on the head, metres and degrees as in rig files; without it, a rig
    made of cameras alone is placed by a guess, for fit-rig to refine."""
    size: Annotated[tuple[int, int] | None, arg(metavar="WIDTH HEIGHT")] = None
    """Image size, for files that do not hold it."""


@dataclass(frozen=True)
class Check:
    """Check a rig for a swapped pair, cameras that look up, impossible measures; exit code 3."""

    rig: Positional[Path]
    """Rig file."""
    json: bool = False
    """Print the findings as JSON."""


@dataclass(frozen=True)
class Show:
    """Draw a rig on a head, its views of a wearer, the joints it sees and its Cramer-Rao bound.

    Poses are drawn from the learned pose prior; the volumetric body occludes joints.
    """

    rig: Positional[Path]
    """Rig file."""
    out: Path
    """Picture to write, png."""
    height: float = 1.75
    """The wearer's height, metres."""
    body: Path | None = None
    """The wearer's body, as fit-body writes it, instead of a height."""
    poses: int = 200
    """Poses over which the measures are taken."""
    sigma: float = 2.0
    """Standard deviation of detections, pixels at an image width of 640."""
    beside: Path | None = None
    """Photo of a view to draw beside the model, with rings of equal angle off the axis."""
    view: str | None = None
    """The photo's view; by default the first."""
    json: bool = False
    """Print the measures as JSON."""


@app.command(name="rig")
def rig_command(
    do: Annotated[
        Annotated[Convert, tyro.conf.subcommand("convert")]
        | Annotated[Check, tyro.conf.subcommand("check")]
        | Annotated[Show, tyro.conf.subcommand("show")],
        arg(name=""),
    ],
) -> int:
    """Convert, check or show a rig."""
    return {Convert: convert, Check: check, Show: show}[type(do)](do)  # type: ignore[operator]


def convert(options: Convert) -> int:
    """`egocap rig convert`."""
    from egocap.cameras.camera_set import CameraSet
    from egocap.cameras.formats import format_cameras
    from egocap.cameras.rig_files import format_rig, load_rig_or_cameras, parse_rig, write_rig
    from egocap.files import write_atomically

    out = options.out
    require_distinct({"out": out}, {"source": options.source})
    if options.size is not None and not all(1 <= side <= _LARGEST_SIDE for side in options.size):
        width, height = options.size
        raise InputError(f"--size {width} {height}", valid=f"1 to {_LARGEST_SIDE}")
    format = options.format or _BY_SUFFIX.get(out.suffix.lower())
    if format is None and out.suffix.lower() == ".json":
        format = "rig"
    if format not in FORMATS:
        raise InputError(f"no format for {out}" if format is None else f"unknown format '{format}'",
                         valid=FORMATS)  # fmt: skip
    found = load_rig_or_cameras(options.source, options.size)
    cameras = found if isinstance(found, CameraSet) else CameraSet.of(found)
    if cameras.worst_px > 0.0:
        print(f"{options.source}: fitted by Kannala-Brandt lenses, off by up to "
              f"{cameras.worst_px:.2f} px (rms {cameras.rms_px:.2f})")  # fmt: skip
    if format == "rig":
        rig = _with_plain_names(_placed(found, options))
        parse_rig(tomllib.loads(format_rig(rig)), options.source)  # or refuse what no command reads
        write_rig(out, rig)
        print(f"{out}: {rig}")
        return DONE
    files, worst = format_cameras(cameras, format, out)
    for path, text in files.items():
        write_atomically(path, text)
        print(f"{path}: {format}" + (f", off by up to {worst:.2g} px" if worst else ""))
    return DONE


def _with_plain_names(rig: Rig) -> Rig:
    """The rig with views named as rig files name them: 'narrow_stereo/left' is cut of its '/'."""
    names = [re.sub(r"[^A-Za-z0-9_-]+", "_", mount.name)[:_LONGEST_NAME] for mount in rig.mounts]
    mounts = zip(rig.mounts, names, strict=True)
    return replace(rig, mounts=tuple(replace(mount, name=name) for mount, name in mounts))


def _placed(found: Any, options: Convert) -> Any:
    """The rig of what was read, on the head."""
    from egocap.cameras.camera_set import GUESS, CameraSet, mount_at

    given = options.mount
    first = None if given is None else mount_at(given[:3], *given[3:])
    if not isinstance(found, CameraSet):
        if first is None:
            return found
        return replace(CameraSet.of(found).rig(found.name, first), frame_rate=found.frame_rate)
    if given is None:
        print(f"{options.out}: guessed: {GUESS}; give --mount, or run egocap fit-rig")
    return found.rig(options.source.stem, first)


def check(options: Check) -> int:
    """`egocap rig check`."""
    from egocap.cameras.rig_check import check_rig
    from egocap.cameras.rig_files import load_rig

    found = check_rig(load_rig(options.rig))
    if options.json:
        print(jsons.dumps({"rig": str(options.rig), "problems": found}, indent=1))
    else:
        for problem in found:
            print(f"{options.rig}: {problem}")
        if not found:
            print(f"{options.rig}: nothing found")
    return MISSED if found else DONE


def show(options: Show) -> int:
    """`egocap rig show`."""
    from egocap.body.proportions import Proportions
    from egocap.cameras.rig_files import load_rig
    from egocap.fitting.wearer import average_body
    from egocap.view.rig_figure import draw_rig, load_photo

    if not 1 <= options.poses <= _MOST_POSES:
        raise InputError(f"{options.poses} poses", valid=f"1 to {_MOST_POSES}")
    if options.body is not None:
        person = Proportions.load(options.body)
    else:
        person = average_body(options.height)
    photo = None if options.beside is None else load_photo(options.beside)
    with progress("rig show", 0):
        found = draw_rig(load_rig(options.rig), options.out, person, options.poses, options.sigma,
                         photo, options.view)  # fmt: skip
    if options.json:
        print(jsons.dumps({"rig": str(options.rig)} | found.to_dict(), indent=1))
        return DONE
    of = found.summary
    print(f"{options.out}: joints seen by a view {of['any_view']:.0%} of the time, by all "
          f"{of['all_views']:.0%}; Cramer-Rao bound {of['bound_mm']:.0f} mm")  # fmt: skip
    return DONE


@app.command
@locks("out")
def correct_rig(
    footage: Positional[Path],
    out: Path,
    rig: Path | None = None,
    track: Path | None = None,
    json: bool = False,
) -> int:
    """Correct a rig file by what its cameras see of the surroundings while the head moves.

    Finds how the cameras are turned and placed to each other, focal lengths, centres, the lag of
    each view and the readout of a rolling shutter. The distance between the cameras and their mean
    place on the head are kept: calibrate and fit-rig find those. mocap does this by itself.

    Args:
        footage: folder of a sequence: some seconds of walking or looking around.
        out: rig to write, .toml or .json.
        rig: rig file to correct; by default the sequence's own.
        track: track of the sequence; its body masks the wearer.
        json: print the corrections as JSON.
    """
    from egocap.cameras.rig_files import load_rig, write_rig
    from egocap.data.sequence import Sequence
    from egocap.data.track import load_track
    from egocap.head_pose.rig_correction import correction_lines, find_rig_correction
    from egocap.head_pose.wearer import WearerMasks
    from egocap.odometry.config import OdometryConfig
    from egocap.odometry.views import Views

    opened, config = Sequence(footage), OdometryConfig()
    given = opened.rig if rig is None else load_rig(rig)
    views = Views.of(given, config.width)
    wearer = None if track is None else WearerMasks(load_track(track), views)
    found = find_rig_correction(opened, views, config, wearer)
    write_rig(out, given if found is None else found.rig(given))
    facts = {} if found is None else found.facts()
    if json:
        print(jsons.dumps({"rig": str(out), "corrections": facts}, indent=1))
        return DONE
    lines = correction_lines(facts) or ["nothing found that differs from the rig file"]
    print(f"{out}: " + "\n".join(lines))
    return DONE


@app.command
@locks("out", "body")
def fit_rig(
    footage: Positional[Path],
    out: Path,
    rig: Path | None = None,
    height: float | None = None,
    neutral: Annotated[tuple[float, float], arg(metavar="FROM TO")] = (0.0, 0.5),
    no_neutral: bool = False,
    position_error: float = 0.03,
    rotation_error: float = 10.0,
    detections: str = "learned",
    seconds: float = 20.0,
    config: Annotated[FitConfig, tyro.conf.OmitArgPrefixes] = FitConfig(),  # noqa: B008
    seed: int = 0,
    body: Path | None = None,
    json: bool = False,
) -> int:
    """Find where a rig sits on the wearer's head today, and the wearer's body, from some seconds.

    The wearer stands upright at first and looks at the horizon, then nods, turns and tilts the
    head, moves the arms and squats, and does as at first after each. What the footage does not
    determine is said.

    Args:
        footage: folder of a sequence.
        out: rig to write, .toml or .json.
        rig: rig file with the cameras and their rough place; by default the sequence's own.
        height: the wearer's height in metres, if known.
        neutral: seconds in which the wearer stands upright and looks at the horizon.
        no_neutral: there are no such seconds; the rotation then stays near the rig file's.
        position_error: standard deviation of the place in the rig file, metres.
        rotation_error: the same of its rotation, degrees.
        detections: where they come from, as for track.
        seconds: length of the part of the footage to use, from its beginning.
        config: the fit's settings.
        seed: seed of simulated detections.
        body: body to write, json.
        json: print the report as JSON.
    """
    from egocap.cameras.rig_files import load_rig, write_rig
    from egocap.data.sequence import Sequence
    from egocap.files import disk_errors, make_folder
    from egocap.fitting.fit_body import first_seconds
    from egocap.fitting.fit_rig import RIG_PASSES, MountError
    from egocap.fitting.fit_rig import fit_rig as fit

    opened = Sequence(footage)
    given = opened.rig if rig is None else load_rig(rig)
    found = first_seconds(detections_from(opened, detections, seed, given), seconds)
    with progress("fit-rig", RIG_PASSES * len(found.times)) as advance:
        result = fit(found, given, height, None if no_neutral else neutral,
                     MountError(position_error, rotation_error), config,
                     on_frames=advance)  # fmt: skip
    write_rig(out, result.rig)
    if body is not None:
        make_folder(body.parent)
        with disk_errors(body.parent):
            result.body.proportions.save(body)
    _print_fit(out, result, json)
    return DONE


def _print_fit(path: Path, fit: RigFit, as_json: bool) -> None:
    report, notes = fit.report(), fit.notes()
    if as_json:
        summary = {
            "rig": str(path), "frames": fit.frames, "neutral_frames": fit.neutral,
            "neutral_stances": fit.stances,
            "converged": fit.converged, "residual": round(fit.residual, 3), "mount": report,
            "notes": notes, "bones": fit.body.report(),
        }  # fmt: skip
        print(jsons.dumps(summary, indent=1))
        return
    unfinished = "" if fit.converged else "; not converged"
    print(f"{path}: from {fit.frames} frames, {fit.neutral} of {fit.stances} neutral stances; "
          f"detections miss by {fit.residual:.2f} standard deviations{unfinished}")  # fmt: skip
    for i, (name, line) in enumerate(report.items()):
        unit = "deg" if i < 3 else "mm"
        seen = "" if line["observed"] else "  not observed: near the rig file"
        print(f"{name:8s} {line['shift']:+7.1f} {unit:3s} +- {line['std']:4.1f}{seen}")
    for note in notes:
        print(note)
