"""Detections and images of a rig in; bone lengths, Gaussian colours and the rig's place out.

`bundle_adjustment` is the problem, `fit_body` and `fit_rig` the procedures.
"""
