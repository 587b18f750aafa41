"""The command `egocap fit-body`."""

from __future__ import annotations

import json as jsons
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional

from egocap.cli.live import CAMERAS
from egocap.cli.registry import app
from egocap.commandline import DONE, progress
from egocap.detect.sources import detections_from
from egocap.errors import InputError
from egocap.fitting.config import FitConfig
from egocap.locks import locks
from egocap.options import several
from egocap.view.capture import CameraSettings

if TYPE_CHECKING:
    from egocap.fitting.fit_body import BodyFit
    from egocap.fitting.guide import Guide


@app.command
@locks("out", "shape")
def fit_body(
    sources: Positional[Annotated[tuple[str, ...], several("SEQUENCE|CAMERA|VIDEO")]],
    /,
    out: Path,
    detections: str = "learned",
    height: float | None = None,
    seconds: float = 20.0,
    config: Annotated[FitConfig, tyro.conf.OmitArgPrefixes] = FitConfig(),  # noqa: B008
    seed: int = 0,
    shape: Path | None = None,
    guided: bool = False,
    rig: Path | None = None,
    cameras: Annotated[CameraSettings, tyro.conf.OmitArgPrefixes] = CAMERAS,
    json: bool = False,
) -> int:
    """Find a person's bone lengths from a few poses or the first seconds of any motion.

    Bones that the motion does not show stay at the population's mean; the report marks them. With
    --guided the wearer is asked for one pose after another, by cameras or videos, until the bones
    of arms and legs are known; Ctrl-C ends the questions.

    Args:
        sources: folder of a sequence; with --guided, camera numbers or video files, one per view.
        out: body to write, json.
        detections: where they come from, as for track; with --guided, learned or learned:FILE.
        height: the person's height in metres, if known.
        seconds: length of the part of the sequence to use, from its beginning.
        config: the fit's settings.
        seed: seed of simulated detections.
        shape: also fit sizes and colours of the Gaussians to the images; json to write.
        guided: say which pose to take, watch, and say when enough is known.
        rig: rig file of the cameras or videos, with --guided.
        cameras: what to ask of the cameras.
        json: print the report as JSON.
    """
    from egocap.files import disk_errors

    sizes = None
    if guided:
        if shape is not None:
            raise InputError("--shape with --guided", valid="--shape with a sequence")
        result = _guided(sources, detections, height, config, rig, cameras)
    else:
        if rig is not None:
            raise InputError("--rig without --guided", valid="a sequence, which has its rig")
        result, sizes = _of_sequence(sources, detections, height, seconds, config, seed, shape)
    with disk_errors(out.parent):
        result.proportions.save(out)
    _print_body(out, result, sizes, json)
    return DONE


def _of_sequence(
    sources: tuple[str, ...], detections: str, height: float | None, seconds: float,
    config: FitConfig, seed: int, shape: Path | None,
) -> tuple[BodyFit, dict[str, float] | None]:  # fmt: skip
    """The body of a sequence's first seconds, and sizes of the Gaussians if `shape` is written."""
    from egocap.data.sequence import open_sequence
    from egocap.files import disk_errors
    from egocap.fitting.fit_body import BODY_PASSES, first_seconds
    from egocap.fitting.fit_body import fit_body as fit

    if len(sources) != 1:
        raise InputError(f"{len(sources)} sequences", valid="one; cameras or videos with --guided")
    opened = open_sequence(sources[0])
    found = first_seconds(detections_from(opened, detections, seed), seconds)
    with progress("fit-body", BODY_PASSES * len(found.times)) as advance:
        result = fit(found, opened.rig, height, config, on_frames=advance)
    if shape is None:
        return result, None
    from egocap.fitting.appearance_fit import fit_shape

    frames = [(opened.frame(int(t)).images, result.angles[i]) for i, t in result.spread(6)]
    with progress("fit shape", 0):
        fitted = fit_shape(result.proportions, opened.rig, frames)
    with disk_errors(shape.parent):
        fitted.body.save(shape)
    return result, fitted.scales


def _guided(
    sources: tuple[str, ...], detections: str, height: float | None, config: FitConfig,
    rig: Path | None, cameras: CameraSettings,
) -> BodyFit:  # fmt: skip
    """Ask for poses on stderr until the guide has no more requests, or the pictures end."""
    from egocap.cameras.rig_files import load_rig
    from egocap.detect.detector import Detector
    from egocap.detect.train.interruption import Interruption
    from egocap.fitting.guide import HOLD_S, Guide
    from egocap.view.feeds import check_sources, open_feed

    kind, _, weights = detections.partition(":")
    if kind != "learned":
        raise InputError(f"--detections {detections} with --guided", valid="learned, learned:FILE")
    if rig is None:
        raise InputError("--guided without --rig", valid="the rig file of the cameras")
    loaded = load_rig(rig)
    check_sources(sources, len(loaded.mounts))
    guide, detector = Guide(loaded, height, config), Detector(loaded, weights or None, streams=1)
    with Interruption() as stop, ExitStack() as stack:
        _say(_request(guide))
        ends: float | None = None
        for instant in open_feed(stack, sources, cameras, lambda: stop.requested):
            ends = instant.time + HOLD_S if ends is None else ends
            if guide.due(instant.time):
                guide.add(detector.detect_images(instant.images, instant.time))
            if instant.time < ends:
                continue
            guide.advance()
            _say(f"{_known(guide)}; {_request(guide)}")
            if guide.request is None:
                break
            ends = None  # the next pose has its time from when it was asked for
        else:
            if ends is not None:
                guide.advance()
            _say(f"{_known(guide)}; no more pictures")
    return guide.finished


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _request(guide: Guide) -> str:
    from egocap.fitting.fit_body import WELL
    from egocap.fitting.guide import HOLD_S

    if guide.request is not None:
        return f"now: {guide.request.words} ({HOLD_S:.0f} s)"
    enough = max(guide.uncertainty().values()) <= WELL
    return "enough is known" if enough else "further poses would tell little more"


def _known(guide: Guide) -> str:
    """How well the bones of arms and legs are known."""
    from egocap.fitting.guide import BONES

    return ", ".join(
        f"{BONES[end]} within {100 * std:.1f} %" if std < 1.0 else f"{BONES[end]} not seen"
        for end, std in guide.uncertainty().items()
    )


def _print_body(path: Path, fit: BodyFit, sizes: dict[str, float] | None, as_json: bool) -> None:
    report = fit.report()
    if as_json:
        summary: dict[str, Any] = {
            "body": str(path), "frames": len(fit.frames), "detections": fit.detections,
            "converged": fit.converged, "residual": round(fit.residual, 3), "bones": report,
        }  # fmt: skip
        print(jsons.dumps(summary if sizes is None else summary | {"sizes": sizes}, indent=1))
        return
    unfinished = "" if fit.converged else "; not converged"
    print(f"{path}: from {fit.detections} detections in {len(fit.frames)} frames, which miss by "
          f"{fit.residual:.2f} standard deviations{unfinished}")  # fmt: skip
    verdicts = {"well": "well determined", "badly": "badly determined",
                "prior": "not seen: population mean"}  # fmt: skip
    print(f"{'bone to':16s} {'length':>9s} {'std':>7s}")
    for name, line in report.items():
        if not name.startswith("right_"):
            bone = name.replace("left_", "")
            print(f"{bone:16s} {1e3 * float(line['length_m']):6.0f} mm {line['std_percent']:5.1f} %"
                  f"  {verdicts[str(line['determined'])]}")  # fmt: skip
    if sizes is not None:
        print("sizes: " + ", ".join(f"{part} {100 * size:.0f} %" for part, size in sizes.items()))
