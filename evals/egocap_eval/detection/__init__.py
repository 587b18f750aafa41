"""Detector weights and validation footage in; PCK, calibration, speed and a model card out.

The footage of `validation` follows the paper's Validation2D.
"""
