"""The program `egocap`."""

from egocap.cli import (  # noqa: F401 (each adds its commands)
    detecting,
    footage,
    live,
    rigs,
    showing,
    tracking,
)
from egocap.cli.registry import app
from egocap.cli.settings import registry
from egocap.commandline import run


def main() -> int:
    """Run `egocap` and return its exit code."""
    with registry:
        return run(
            app, prog="egocap", description="Full-body motion from head-worn fisheye cameras."
        )
