"""Commands that read footage: import, mocap."""

from __future__ import annotations

import json as jsons
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional

from egocap.cli.checks import check_body, check_head_pose, check_weights
from egocap.cli.compile_ahead import compiling_ahead
from egocap.cli.many import are_several, print_report, run_several
from egocap.cli.registry import app
from egocap.commandline import DONE, MISSED, progress
from egocap.errors import InputError
from egocap.footage.config import ImportOptions
from egocap.locks import holding
from egocap.motion_capture.config import MocapOptions
from egocap.options import several

if TYPE_CHECKING:
    from egocap.data.sequence import Sequence as Recording
    from egocap.execution.recording_task import Report
    from egocap.motion_capture.capture import Capture

IMPORT, MOCAP = ImportOptions(), MocapOptions()


@app.command(name="import")
def import_(
    out: Path,
    sources: Positional[Annotated[tuple[str, ...], several("VIDEO|FOLDER")]] = (),
    rig: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    options: Annotated[ImportOptions, tyro.conf.OmitArgPrefixes] = IMPORT,
    dataset: Annotated[str | None, tyro.conf.arg(metavar="NAME:PATH")] = None,
    sequence: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    json: bool = False,
) -> int:
    """Import videos or folders of pictures as a sequence, for every other command.

    Frames follow the first view's clock. Frames that were dropped, repeated or damaged are found,
    reported, and missing in the sequence.

    Without sources, an imported sequence at --out gets other clocks, colours or another range.

    Args:
        sources: a video, or a folder of pictures, for every view in the order of the rig.
        rig: rig file of the cameras.
        out: folder of the sequence to write; the same command completes an interrupted one.
        options: how the footage is read.
        dataset: a published data set and its folder, in place of sources; a rig file then
            replaces its cameras, and of the other options --copy is used.
        sequence: name of the data set's sequence, where it holds several.
        json: print the summary as JSON.
    """
    from egocap.footage.importing import edit_footage, import_footage

    if dataset is not None:
        if sources:
            raise InputError("--dataset together with sources", valid="one of them")
        return _import_dataset(dataset, sequence, rig, out, options.copy, json)
    edits = not sources and rig is None and options != IMPORT
    if not edits and (rig is None or not sources):
        raise InputError("no --rig or no sources", valid="sources and --rig FILE, or --dataset")
    with ExitStack() as stack:
        if rig is None:
            found = edit_footage(out, options, steps(stack))
        else:
            found = import_footage(sources, rig, out, options, steps(stack))
    print_footage(found, json)
    return DONE


def _import_dataset(
    dataset: str, sequence: str | None, rig: Path | None, out: Path, copy: bool, as_json: bool
) -> int:
    from egocap.cameras.rig_files import load_rig
    from egocap.datasets.catalogue import find_recording
    from egocap.datasets.importing import import_recording

    found = find_recording(dataset, sequence, None if rig is None else load_rig(rig))
    with progress("copy", len(found) if copy else 0) as advance:
        import_recording(found, out, copy=copy, on_frames=advance)
    apart = found.reprojection_px()
    if as_json:
        print(jsons.dumps({"sequence": str(out), "frames": len(found), "views": found.rig.views,
                          "labels_off_px": apart}, indent=1))  # fmt: skip
    else:
        labels = "" if apart is None else f"; labels reproject within {apart:.2f} px (median)"
        print(f"{out}: {len(found)} frames at {found.rig.frame_rate:g} Hz, "
              f"views {', '.join(found.rig.views)}{labels}")  # fmt: skip
    return DONE


def steps(stack: ExitStack) -> Callable[[str, int], Callable[[int], None]]:
    """Shows the progress of one named step after another."""

    def begin(name: str, total: int) -> Callable[[int], None]:
        stack.close()
        return stack.enter_context(progress(name, total))

    return begin


def print_footage(sequence: Recording, as_json: bool) -> None:
    """Frames of the sequence, and what was found in each view's pictures."""
    from egocap.footage.summary import describe, summary

    if as_json:
        print(jsons.dumps(summary(sequence), indent=1))
        return
    for line in describe(sequence):
        print(line)


@app.command
def mocap(
    sources: Positional[Annotated[tuple[str, ...], several("VIDEO|FOLDER")]],
    rig: Path,
    out: Path,
    options: Annotated[MocapOptions, tyro.conf.OmitArgPrefixes] = MOCAP,
    footage: Annotated[ImportOptions, tyro.conf.OmitArgPrefixes] = IMPORT,
    strict: bool = False,
    workers: int | None = None,
    cluster: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None,
    json: bool = False,
) -> int:
    """Capture the motion of the wearer of a rig from footage of its cameras.

    Writes track.npz, motion.bvh, film.mp4 and index.html, a page of what was found, how certain it
    is and what to improve. The same command goes on where an interrupted one stopped.

    Args:
        sources: a video, or a folder of pictures, for every view in the order of the rig; of
            several recordings with this rig, one after another.
        rig: rig file of the cameras.
        out: folder of the results; of several recordings, and with --workers or --cluster, the
            folder that holds theirs.
        options: what is known of the wearer, and what to write.
        footage: how the footage is read.
        strict: exit with 3 if footage, rig and body do not fit each other; all files are written.
        workers: processes, each with a recording at a time; 0, the default: this one.
        cluster: run on the workers of this Dask scheduler, e.g. tcp://host:8786.
        json: print the findings as JSON.
    """
    settings = {"rig": rig, "options": options, "footage": footage}
    several = workers, cluster
    if not are_several(found := _recordings(sources, rig, footage), several):
        with compiling_ahead():
            made = _capture(sources, out, **settings)
        report = _report(made)
        if json:
            print_report("folder", out, report, json)
        else:
            print_footage(made.sequence, as_json=False)
            print(f"{out / 'index.html'}: " + "\n".join(report.lines))
        return MISSED if strict and report.missed else DONE
    from egocap.execution.recordings import list_recordings

    if cluster is None:
        check_body(options.body)
        check_weights(options.weights)
        check_head_pose(options.head_pose)
    return run_several("mocap", _mocap, settings, list_recordings(found), out, several,
                       strict=strict, as_json=json)  # fmt: skip


def _recordings(
    sources: Sequence[str], rig: Path, footage: ImportOptions
) -> list[tuple[str, tuple[str, ...]]]:
    """Names and sources of the recordings: the sources in groups of one for every view.

    A name is what the files of a recording begin with in common, or that of their folder.
    Raises InputError for sources that are left over.
    """
    from egocap.cameras.rig_files import load_rig
    from egocap.storage.copies import here

    views = 1 if footage.side_by_side else len(load_rig(here(rig)).views)
    if len(sources) > views and len(sources) % views:
        raise InputError(f"{len(sources)} sources for {views} views",
                         valid=f"{views} for every recording")  # fmt: skip
    groups = [tuple(sources[i : i + views]) for i in range(0, len(sources), views)]
    return [(_begin([Path(source).stem for source in group]).rstrip("-_. ")
             or Path(group[0]).absolute().parent.name, group) for group in groups]  # fmt: skip


def _begin(words: Sequence[str]) -> str:
    """The letters with which all words begin."""
    same = takewhile(lambda letters: len(set(letters)) == 1, zip(*words, strict=False))
    return "".join(letters[0] for letters in same)


def _capture(
    sources: tuple[str, ...], out: Path, rig: Path, options: MocapOptions, footage: ImportOptions
) -> Capture:
    from egocap.motion_capture.capture import mocap

    with holding(out, folder=True), ExitStack() as stack:
        return mocap(sources, rig, out, options, footage, on_step=steps(stack))


def _mocap(sources: tuple[str, ...], out: Path, **settings: Any) -> Report:
    return _report(_capture(sources, out, **settings))


def _report(made: Capture) -> Report:
    from egocap.execution.recording_task import Report
    from egocap.track.consistency import warning_of

    sure = f"a joint is within 5 cm with a probability of {100 * made.findings.sure.mean():.0f} %"
    lines = (sure, *(f"  {line}" for line in made.findings.advice))
    return Report(made.findings.to_dict(), lines, warning_of(made.track) is not None)
