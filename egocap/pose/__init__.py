"""Detections in; the energy of a pose, its derivatives and its priors out.

`energy` is the readable form of every term; `kernel` is its compiled form and is tested against it.
"""
