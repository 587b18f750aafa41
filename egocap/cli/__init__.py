"""Command-line words in; files and printed results out: the command `egocap`.

One module a group of commands. Nothing imports this room.
"""

from egocap.cli.program import main

__all__ = ["main"]
