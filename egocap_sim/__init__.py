"""The simulated world: scene files in; fisheye footage of people with exact truth out.

It uses only the cameras, body and data rooms of `egocap`.
"""
