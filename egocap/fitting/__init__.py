"""Detections and images of a known rig in; a person's bone lengths and Gaussian colours out.

`bundle_adjustment` is the problem, `fit_body` the procedure, `body_prior` the population.
"""
