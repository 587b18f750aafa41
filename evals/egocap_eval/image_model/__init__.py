"""Simulated frames in; exactness and convergence of the image model out.

`study` runs both parts, `exactness` and `basin`.
"""
