"""The command egocap-eval; its commands are the studies of `egocap_eval.harness.commands`."""

from collections.abc import Sequence

from egocap.commandline import start

__all__ = ["main"]


def main(args: Sequence[str] | None = None) -> int:
    """Run a command line (the process's own when None) and return the exit code."""

    def program() -> int:
        from egocap_eval.harness.commands import main

        return main(args)

    return start("egocap-eval", program)
