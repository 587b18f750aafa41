"""Command-line words in; files and printed results out: the command `egocap`.

One module a group of commands. Nothing imports this room.
"""

from egocap.commandline import start

__all__ = ["main"]


def main() -> int:
    """Run `egocap` and return its exit code."""

    def program() -> int:
        from egocap.cli.program import main

        return main()

    return start("egocap", program)
