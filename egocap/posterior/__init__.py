"""Detections of one frame in; the posterior of its pose, sampled and bounded, out.

`log_prob` is the density, `laplace` its modes, `sampler` draws from it with emcee, `information`
bounds what any method can know, `synthetic_pose` draws people and detections from it.
"""
