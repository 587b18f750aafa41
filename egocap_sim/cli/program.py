"""The program `egocap-sim`, of the commands of all modules."""

from egocap.commandline import run
from egocap.storage.words import local_words
from egocap_sim.cli import (  # noqa: F401 (each adds its commands)
    generating,
    outputs,
    refining,
    verifying,
)
from egocap_sim.cli.registry import app


def main() -> int:
    """Run `egocap-sim` and return its exit code."""
    return run(
        app,
        prog="egocap-sim",
        description="Simulate egocentric stereo fisheye footage with ground truth.",
        within=local_words,
    )
