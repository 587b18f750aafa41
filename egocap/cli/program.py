"""The program `egocap`."""

import sys

from egocap.cli import (  # noqa: F401 (each adds its commands)
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


def main() -> int:
    """Run `egocap` and return its exit code."""
    words = sys.argv[1:]
    if tuple(words[:2]) in _PAIRS:
        words = [_PAIRS[words[0], words[1]], *words[2:]]
    description = "Full-body motion from head-worn fisheye cameras."
    with registry:
        return run(app, prog="egocap", description=description, args=words, within=local_words)
