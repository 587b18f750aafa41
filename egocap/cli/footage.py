"""Commands that read footage: import."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional

from egocap.cli.registry import app
from egocap.commandline import DONE, progress
from egocap.footage.config import ImportOptions

if TYPE_CHECKING:
    from egocap.data.sequence import Sequence

IMPORT = ImportOptions()


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
        print(json.dumps(summary(sequence), indent=1))
        return
    for line in describe(sequence):
        print(line)
