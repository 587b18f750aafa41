"""The command `egocap-sim`: generate, preview, verify, export and summarise sequences."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional
from tyro.extras import SubcommandApp

from egocap.commandline import DONE, USAGE, progress, run
from egocap.storage.words import local_words
from egocap_sim.boards.settings import BoardRecording
from egocap_sim.world.overrides import UNCHANGED, Overrides, override_scene, shown

if TYPE_CHECKING:
    from egocap_sim.motion.clips.clip_check import ClipReport
    from egocap_sim.motion.clips.load import LoadedMotion
    from egocap_sim.record.sequence_recorder import Summary
    from egocap_sim.scene.config import Scene

app = SubcommandApp()


@app.command
def generate(
    scenes: Positional[tuple[str, ...]],
    out: Path,
    overrides: Annotated[Overrides, tyro.conf.OmitArgPrefixes] = UNCHANGED,
    workers: int | None = None,
    cluster: Annotated[str | None, shown("ADDRESS")] = None,
    append: bool = False,
    strict: bool = False,
    json: bool = False,
) -> int:
    """Simulate scenes and render them into sequences.

    Run the same command again to continue an interrupted run.

    Args:
        scenes: names of built-in scenes, or scene files.
        out: folder of the sequence; of several scenes, the folder that holds theirs.
        overrides: changes of the scenes.
        workers: number of rendering processes; 0: this one. By default this one for at most 100
            frames, else 2.
        cluster: render on the workers of this Dask scheduler, e.g. tcp://host:8786.
        append: extend a finished sequence of fewer frames up to --frames.
        strict: stop at a motion file that is suspect (check-motion), and at one in --motions that
            cannot be read, instead of skipping it.
        json: print the summary as JSON; of several scenes, a list.
    """
    from egocap.errors import InputError
    from egocap_sim.core.resources import find_file
    from egocap_sim.scene.config import load_scene

    if not scenes:
        raise InputError("no scene given", valid="names or files of scenes")
    files = [find_file("scene", name) for name in scenes]
    loaded = [override_scene(load_scene(file), overrides) for file in files]
    names = [scene.name for scene in loaded]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"two scenes have the name '{twice[0]}'", valid="different names")
    done = []
    for file, scene in zip(files, loaded, strict=True):
        summary = _generate(
            scene, file, out / scene.name if len(loaded) > 1 else out, workers, cluster,
            append, strict,
        )  # fmt: skip
        done.append(_as_json(summary))
        if not json:
            _print_summary(summary)
    if json:
        _print_json(done if len(done) > 1 else done[0])
    return DONE


@app.command
def preview(sequence: Positional[Path], out: Path, rows: int = 6, width: int = 480) -> int:
    """Write a contact sheet: every view, joints over the image, part labels.

    Args:
        sequence: folder of a sequence, or a folder of sequences.
        out: PNG or JPEG file to write.
        rows: frames to show, spread over the sequence.
        width: width of one picture in pixels.
    """
    from egocap_sim import api

    api.preview(sequence, out, rows=rows, width=width)
    print(out)
    return DONE


@app.command
def verify(sequence: Positional[Path], json: bool = False, rays: int = 0) -> int:
    """Check that a sequence is complete, undamaged and consistent.

    Args:
        sequence: folder of a sequence, or of a recording in episodes.
        json: print the result as JSON.
        rays: also recompute joint visibility in this many frames by ray casting in MuJoCo.
    """
    from dataclasses import asdict

    from egocap_sim.verification.integrity import frames_to_check
    from egocap_sim.verification.integrity import verify as check

    with progress("verify", frames_to_check(sequence, rays)) as advance:
        result = check(sequence, rays, advance)
    if json:
        _print_json({"folder": str(sequence), "clean": result.clean, "frames": result.frames,
                     "shards": result.shards, "bytes": result.bytes,
                     "problems": list(result.problems),
                     "rays": asdict(result.rays) if result.rays else None})  # fmt: skip
    elif result.clean:
        size = result.bytes / 1e6
        print(f"{sequence}: {result.frames} frames in {result.shards} shards, {size:.0f} MB, clean")
        if result.rays:
            print(f"{sequence}: {result.rays.text()}")
    else:
        for problem in result.problems:
            print(f"{sequence}: {problem}", file=sys.stderr)
    return DONE if result.clean else USAGE


@app.command
def export(
    sequence: Positional[Path],
    out: Path,
    format: Annotated[str, shown("coco|unrealego|mp4|videos|head-pose|imu")],
) -> int:
    """Export a sequence to another format.

    Args:
        sequence: folder of a sequence, or a folder of sequences.
        out: new folder, or the .mp4, .npz (head-pose) or .csv (imu) file; of several sequences, the
            folder that holds theirs.
        format: coco (keypoints JSON and images), unrealego (a JSON file a frame, in cm), mp4 (a
            video with the joints drawn) or videos (a file of every camera as a camera would write
            it, without truth; planted.json says what was changed), head-pose (the true head poses,
            for `egocap track --head-pose`) or imu (gyroscope and accelerometer in the head frame,
            at 200 Hz, with noise and bias).
    """
    from egocap.data.dataset import find_sequences
    from egocap.data.sequence import Sequence
    from egocap_sim.export.formats import ENDINGS
    from egocap_sim.export.formats import export as export_sequence

    found = find_sequences([sequence])
    opened = [Sequence(folder) for folder in found]
    ending = ENDINGS.get(format, "")
    with progress(format, sum(map(len, opened))) as advance:
        for folder, each in zip(found, opened, strict=True):
            into = out if folder == sequence else out / f"{folder.name}{ending}"
            export_sequence(each, format, into, advance)
    print(out)
    return DONE


@app.command
def stats(
    folders: Positional[tuple[Path, ...]], out: Path | None = None, json: bool = False
) -> int:
    """Summarise the content of sequences: people, poses, visibility, image positions, contacts.

    Args:
        folders: sequences, or folders of sequences.
        out: HTML page to write.
        json: print the numbers as JSON.
    """
    from egocap.data.dataset import find_sequences
    from egocap.errors import InputError
    from egocap.files import write_atomically
    from egocap_sim.stats.collect import Statistics
    from egocap_sim.stats.page import render_page, summary

    if not folders:
        raise InputError("no folder given", valid="sequences, or folders of sequences")
    if out is not None and out.suffix.lower() != ".html":
        raise InputError(f"cannot write '{out.name}'", valid="a name that ends in .html")
    found = find_sequences(folders)
    statistics = Statistics()
    with progress("sequences", len(found), unit="sequences") as advance:
        for folder in found:
            statistics.add(folder)
            advance(1)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(out, render_page(statistics).encode())
    numbers = summary(statistics)
    if json:
        _print_json(numbers)
        return DONE
    if out is not None:
        print(out)
    print(f"{numbers['frames']} stereo frames in {numbers['sequences']} sequences, "
          f"{numbers['people']} people, {numbers['bytes'] / 1e6:.0f} MB")  # fmt: skip
    for name, joint in numbers["joints"].items():
        print(f"{name:15} visible in {joint['visible']:5.1f} % of images, "
              f"by any camera in {joint['seen_by_any']:5.1f} % of frames")  # fmt: skip
    return DONE


@app.command(name="check-motion")
def check_motion(
    files: Positional[tuple[Path, ...]],
    out: Path | None = None,
    strict: bool = False,
    json: bool = False,
) -> int:
    """Check motion files against anatomy, speed and the floor, and list what cleaning changes.

    Args:
        files: BVH and npz files, or folders of them.
        out: HTML page with stick figures to write.
        strict: exit with 3 if a file is suspect or cannot be read.
        json: print the findings as JSON.
    """
    from egocap.commandline import MISSED
    from egocap.errors import InputError
    from egocap.files import make_folder, write_atomically
    from egocap_sim.stats.motion_page import render_motions

    if not files:
        raise InputError("no file given", valid="BVH and npz files, or folders of them")
    if out is not None and out.suffix.lower() != ".html":
        raise InputError(f"cannot write '{out.name}'", valid="a name that ends in .html")
    motions, unreadable = _read_motions(files)
    if out is not None:
        make_folder(out.parent)
        write_atomically(out, render_motions(motions, unreadable))
    reports = [(path, motion.report) for path, motion in motions]
    if json:
        _print_json([{"file": path, **report.to_dict()} for path, report in reports]
                    + [{"file": path, "verdict": "unreadable", "error": text}
                       for path, text in unreadable])  # fmt: skip
    else:
        _print_reports(reports, unreadable)
    bad = bool(unreadable) or any(report.suspect for _, report in reports)
    return MISSED if strict and bad else DONE


@app.command
def calibration_board(
    out: Path,
    board: str = "charuco:5x7:0.0325:0.024",
    rig: str = "egorig1",
    settings: Annotated[BoardRecording, tyro.conf.OmitArgPrefixes] = BoardRecording(),  # noqa: B008
    size: Annotated[tuple[int, int] | None, shown("WIDTH HEIGHT")] = None,
) -> int:
    """Render a calibration board that a hand moves before a rig.

    Writes a folder of pictures per camera for `egocap calibrate`, and truth.json to score it with.

    Args:
        out: new folder.
        board: the board, as in `egocap calibrate`.
        rig: name of a built-in rig, or a rig file.
        settings: pictures and camera faults.
        size: image size in pixels; the rig is scaled to it.
    """
    from egocap.boards.board import parse_board
    from egocap.cameras.rig_files import load_rig
    from egocap_sim.boards.record import record_board
    from egocap_sim.core.resources import find_file

    opened = load_rig(find_file("rig", rig))
    opened = opened.resized(*size) if size else opened
    with progress("pictures", settings.count * len(opened.views), unit="pictures") as advance:
        record_board(parse_board(board), opened, settings, out, advance)
    print(out)
    return DONE


@app.command(name="list")
def list_() -> int:
    """List the built-in scenes, rigs, motions and sensors."""
    from egocap_sim.core.resources import builtin_names, rig_names
    from egocap_sim.motion.generators.registry import MOTIONS
    from egocap_sim.sensor.config import PRESETS

    print("scenes: ", *builtin_names("scene"))
    print("rigs:   ", *rig_names())
    print("motions:", *MOTIONS)
    print("sensors:", *PRESETS)
    return DONE


def main() -> int:
    """Run `egocap-sim` and return its exit code."""
    return run(
        app,
        prog="egocap-sim",
        description="Simulate egocentric stereo fisheye footage with ground truth.",
        within=local_words,
    )


def _generate(
    scene: Scene,
    file: Path,
    folder: Path,
    workers: int | None,
    cluster: str | None,
    append: bool,
    strict: bool,
) -> Summary:
    from egocap.errors import FileError
    from egocap_sim.record.recorder import generate as generate_sequence
    from egocap_sim.scene.scene_error import SceneError

    try:
        with progress(scene.name, scene.frames) as advance:
            return generate_sequence(
                scene, folder, workers=workers, cluster=cluster, append=append, strict=strict,
                on_frames=advance,
            )  # fmt: skip
    except SceneError as error:
        raise FileError(file, error.problem, key=error.key) from None


def _as_json(summary: Summary) -> dict[str, object]:
    physics = vars(summary.physics) if summary.physics else None
    return {"folder": str(summary.folder), "frames": summary.frames, "rendered": summary.rendered,
            "seconds": summary.seconds, "bytes": summary.bytes, "physics": physics,
            "motions": [report.to_dict() for report in summary.motions],
            "episodes": summary.episodes, "people": summary.people,
            "bystanders": summary.bystanders}  # fmt: skip


def _print_summary(summary: Summary) -> None:
    size = summary.bytes / 1e6
    if not summary.rendered:
        print(f"{summary.folder}: {summary.frames} frames, {size:.0f} MB, already complete")
        return
    wearers = "1 wearer" if summary.people == 1 else f"{summary.people} wearers"
    others = f" among {summary.bystanders} others" if summary.bystanders else ""
    print(f"{summary.folder}: {summary.frames} stereo frames of {wearers}{others}, {size:.0f} MB, "
          f"{summary.frames_per_second:.1f} frames/s")  # fmt: skip
    if stats := summary.physics:
        print(f"physics: joints within {stats.joint_error_cm:.2f} cm of the reference (max "
              f"{stats.joint_error_max_cm:.1f}), planted feet {stats.planted_foot_speed_cm_s:.1f} "
              f"cm/s, residual wrench {stats.residual_wrench_bw:.2f} body weights")  # fmt: skip
        if stats.raw_error_cm is not None:
            print(f"         joints within {stats.raw_error_cm:.2f} cm of the motion file as "
                  f"recorded (max {stats.raw_error_max_cm:.1f})")  # fmt: skip


def _read_motions(
    files: tuple[Path, ...],
) -> tuple[list[tuple[str, LoadedMotion]], list[tuple[str, str]]]:
    """Motions of files and folders by path, and the errors of those that cannot be read."""
    from egocap.errors import EgocapError
    from egocap_sim.motion.clips.clip_store import stored_motion
    from egocap_sim.record.episode_plan import clip_files

    paths = [p for f in files for p in (clip_files(f) if f.is_dir() else [f])]
    motions, unreadable = [], []
    with progress("motions", len(paths), unit="files") as advance:
        for path in paths:
            try:
                motions.append((str(path), stored_motion(path)))
            except EgocapError as error:
                unreadable.append((str(path), str(error)))
            advance(1)
    return motions, unreadable


def _print_reports(
    reports: list[tuple[str, ClipReport]], unreadable: list[tuple[str, str]]
) -> None:
    """Print the table of checked motion files."""
    print(f"{'verdict':10} {'frames':>6} {'Hz':>6} {'moved cm':>8} {'max':>5}  file, findings")
    for path, report in reports:
        print(f"{report.verdict:10} {report.frames:6} {report.fps:6.4g} {report.moved_cm:8.1f} "
              f"{report.moved_max_cm:5.0f}  {path}")  # fmt: skip
        for finding in report.findings:
            print(f"{'':41}{'! ' if finding.severe else '- '}{finding}")
    for path, text in unreadable:
        print(f"{'unreadable':41}{path}: {text}")


def _print_json(content: object) -> None:
    print(json.dumps(content, indent=1))
