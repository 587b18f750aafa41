"""EgoCap: full-body motion capture from two head-worn fisheye cameras."""

__version__ = "0.1.0"
