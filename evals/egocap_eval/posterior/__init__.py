"""Sampled posteriors in; coverage, rank statistics and speed out.

`calibration` runs the study and `coverage` counts.
"""
