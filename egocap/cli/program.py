"""The program `egocap`."""

import sys
from functools import partial

from egocap.cli import (  # noqa: F401 (each adds its commands)
    bodies,
    calibrating,
    detecting,
    doctor,
    footage,
    head_pose,
    live,
    rigs,
    showing,
    tracking,
    weights,
)
from egocap.cli.registry import app
from egocap.cli.settings import registry
from egocap.commandline import run
from egocap.storage.words import local_words

_PAIRS = {("calibrate", "print-board"): "print-board"}
"""Commands of two words, and the name under which they are registered."""
_ON_WORKERS = ("detect", "track", "mocap")
"""Commands whose inputs are read where they run: with --cluster, on its workers."""


def main() -> int:
    """Run `egocap` and return its exit code."""
    words = sys.argv[1:]
    if tuple(words[:2]) in _PAIRS:
        words = [_PAIRS[words[0], words[1]], *words[2:]]
    description = "Full-body motion from head-worn fisheye cameras."
    elsewhere = words[:1] in [[name] for name in _ON_WORKERS] and any(
        word.partition("=")[0] == "--cluster" for word in words
    )
    within = partial(local_words, inputs=not elsewhere)
    with registry:
        return run(app, prog="egocap", description=description, args=words, within=within)
