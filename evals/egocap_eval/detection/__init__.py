"""Detector weights and held-out footage in; PCK, calibration, speed and a model card out.

The footage of `heldout` follows the paper's Validation2D.
"""
