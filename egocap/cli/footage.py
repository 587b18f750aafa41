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
from egocap.commandline import DONE, progress
from egocap.footage.config import ImportOptions
from egocap.motion_capture.config import MocapOptions

if TYPE_CHECKING:
    from egocap.data.sequence import Sequence

IMPORT, MOCAP = ImportOptions(), MocapOptions()


@app.command(name="import")
def import_(
    sources: Positional[tuple[str, ...]],
    rig: Path,
    out: Path,
    options: Annotated[ImportOptions, tyro.conf.OmitArgPrefixes] = IMPORT,
    json: bool = False,
) -> int:
    """Import videos or folders of pictures as a sequence, for every other command.

    Frames follow the first view's clock. Frames that were dropped, repeated or damaged are found,
    reported, and missing in the sequence.

    Args:
        sources: a video, or a folder of pictures, for every view in the order of the rig.
        rig: rig file of the cameras.
        out: folder of the sequence to write; the same command completes an interrupted one.
        options: how the footage is read.
        json: print the summary as JSON.
    """
    from egocap.footage.importing import import_footage

    with ExitStack() as stack:
        found = import_footage(sources, rig, out, options, steps(stack))
    print_footage(found, json)
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
def mocap(
    sources: Positional[tuple[str, ...]],
    rig: Path,
    out: Path,
    options: Annotated[MocapOptions, tyro.conf.OmitArgPrefixes] = MOCAP,
    footage: Annotated[ImportOptions, tyro.conf.OmitArgPrefixes] = IMPORT,
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
        json: print the findings as JSON.
    """
    from egocap.motion_capture.capture import mocap as capture

    with ExitStack() as stack:
        made = capture(sources, rig, out, options, footage, on_step=steps(stack))
    if json:
        print(jsons.dumps({"folder": str(out)} | made.findings.to_dict(), indent=1))
        return DONE
    print_footage(made.sequence, as_json=False)
    print(f"{out / 'index.html'}: a joint is within 5 cm with a probability of "
          f"{100 * float(made.findings.sure.mean()):.0f} %")  # fmt: skip
    for line in made.findings.advice:
        print(f"  {line}")
    return DONE
