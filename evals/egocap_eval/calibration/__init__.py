"""Simulated pictures of boards in; errors of the calibrated lenses and camera poses out.

Scores alone read the truth of a recording; the calibration gets its pictures.
"""
