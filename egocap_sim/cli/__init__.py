"""Command-line words in; sequences, pages and printed results out: the command `egocap-sim`.

One module a group of commands. Nothing imports this room.
"""

from egocap.commandline import start

__all__ = ["main"]


def main() -> int:
    """Run `egocap-sim` and return its exit code."""

    def program() -> int:
        from egocap_sim.cli.program import main

        return main()

    return start("egocap-sim", program)
