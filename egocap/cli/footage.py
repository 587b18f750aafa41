"""Commands that read footage: import, mocap."""

from __future__ import annotations

import json as jsons
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional

from egocap.cli.registry import app
from egocap.commandline import DONE, MISSED, progress
from egocap.errors import InputError
from egocap.footage.config import ImportOptions
from egocap.locks import locks
from egocap.motion_capture.config import MocapOptions

if TYPE_CHECKING:
    from egocap.data.sequence import Sequence

IMPORT, MOCAP = ImportOptions(), MocapOptions()


@app.command(name="import")
def import_(
    out: Path,
    sources: Positional[tuple[str, ...]] = (),
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


def print_footage(sequence: Sequence, as_json: bool) -> None:
    """Frames of the sequence, and what was found in each view's pictures."""
    from egocap.footage.summary import describe, summary

    if as_json:
        print(jsons.dumps(summary(sequence), indent=1))
        return
    for line in describe(sequence):
        print(line)


@app.command
@locks("out", folder=True)
def mocap(
    sources: Positional[tuple[str, ...]],
    rig: Path,
    out: Path,
    options: Annotated[MocapOptions, tyro.conf.OmitArgPrefixes] = MOCAP,
    footage: Annotated[ImportOptions, tyro.conf.OmitArgPrefixes] = IMPORT,
    strict: bool = False,
    json: bool = False,
) -> int:
    """Capture the motion of the wearer of a rig from footage of its cameras.

    Writes track.npz, motion.bvh, film.mp4 and index.html, a page of what was found, how certain it
    is and what to improve. The same command goes on where an interrupted one stopped.

    Args:
        sources: a video, or a folder of pictures, for every view in the order of the rig.
        rig: rig file of the cameras.
        out: folder of the results.
        options: what is known of the wearer, and what to write.
        footage: how the footage is read.
        strict: exit with 3 if footage, rig and body do not fit each other; all files are written.
        json: print the findings as JSON.
    """
    from egocap.motion_capture.capture import mocap as capture
    from egocap.track.consistency import warning_of

    with ExitStack() as stack:
        made = capture(sources, rig, out, options, footage, on_step=steps(stack))
    code = MISSED if strict and warning_of(made.track) else DONE
    if json:
        print(jsons.dumps({"folder": str(out)} | made.findings.to_dict(), indent=1))
        return code
    print_footage(made.sequence, as_json=False)
    print(f"{out / 'index.html'}: a joint is within 5 cm with a probability of "
          f"{100 * float(made.findings.sure.mean()):.0f} %")  # fmt: skip
    for line in made.findings.advice:
        print(f"  {line}")
    return code
