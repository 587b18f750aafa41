"""Detections and images in; tracks by the solvers of the EgoCap paper out.

The paper's constants are in `config` and are not tuned; this room is the reference for our solver.
"""
