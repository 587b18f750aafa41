"""The command `egocap`: motion out of footage."""

from egocap.cli.program import main
from egocap.cli.sources import detections_from

__all__ = ["detections_from", "main"]
