"""The commands that verify sequences and motion files, sum them up, and list what is built in."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from egocap.commandline import DONE, USAGE, progress
from egocap.options import several
from egocap_sim.cli.registry import app, print_json

if TYPE_CHECKING:
    from egocap_sim.motion.clips.clip_check import ClipReport
    from egocap_sim.motion.clips.load import LoadedMotion


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
        print_json({"folder": str(sequence), "clean": result.clean, "frames": result.frames,
                    "shards": result.shards, "bytes": result.bytes,
                    "problems": list(result.problems),
                    "rays": asdict(result.rays) if result.rays else None})  # fmt: skip
    elif result.clean:
        size = result.bytes / 1e6
        print(f"{sequence}: {result.frames} frames in {result.shards} shards, {size:.1f} MB, clean")
        if result.rays:
            print(f"{sequence}: {result.rays.text()}")
    else:
        for problem in result.problems:
            print(f"{sequence}: {problem}", file=sys.stderr)
    return DONE if result.clean else USAGE


@app.command
def stats(
    folders: Positional[Annotated[tuple[Path, ...], several("DIR")]],
    out: Path | None = None,
    json: bool = False,
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
        print_json(numbers)
        return DONE
    if out is not None:
        print(out)
    print(f"{numbers['frames']} frames in {numbers['sequences']} sequences, "
          f"{numbers['people']} people, {numbers['bytes'] / 1e6:.1f} MB")  # fmt: skip
    for name, joint in numbers["joints"].items():
        print(f"{name:15} visible in {joint['visible']:5.1f} % of images, "
              f"by any camera in {joint['seen_by_any']:5.1f} % of frames")  # fmt: skip
    return DONE


@app.command(name="check-motion")
def check_motion(
    files: Positional[Annotated[tuple[Path, ...], several("FILE|DIR")]],
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
        print_json([{"file": path, **report.to_dict()} for path, report in reports]
                   + [{"file": path, "verdict": "unreadable", "error": text}
                      for path, text in unreadable])  # fmt: skip
    else:
        _print_reports(reports, unreadable)
    bad = bool(unreadable) or any(report.suspect for _, report in reports)
    return MISSED if strict and bad else DONE


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


def _read_motions(
    files: tuple[Path, ...],
) -> tuple[list[tuple[str, LoadedMotion]], list[tuple[str, str]]]:
    """Motions of files and folders by path, and the errors of those that cannot be read."""
    from egocap.errors import EgocapError, FileError
    from egocap_sim.motion.clips.clip_store import stored_motion
    from egocap_sim.record.episode_plan import clip_files

    for file in files:
        if not file.exists():
            raise FileError(file, "no such file or folder", valid="clips, .bvh or .npz")
    paths = [p for f in files for p in (clip_files(f) if f.is_dir() else [f])]
    motions, unreadable = [], []
    with progress("motions", len(paths), unit="files") as advance:
        for path in paths:
            try:
                motions.append((str(path), stored_motion(path)))
            except EgocapError as error:
                unreadable.append((str(path), str(error).removeprefix(f"{path}: ")))
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
