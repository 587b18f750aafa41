"""The command egocap-eval; its commands are the studies of `egocap_eval.harness.commands`."""

from egocap_eval.harness.commands import main

__all__ = ["main"]
