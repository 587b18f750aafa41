"""The command egocap-eval; its commands are the studies of `egocap_eval.harness.commands`."""

from egocap.commandline import start

__all__ = ["main"]


def main() -> int:
    """Run `egocap-eval` and return its exit code."""

    def program() -> int:
        from egocap_eval.harness.commands import main

        return main()

    return start("egocap-eval", program)
