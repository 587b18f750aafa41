"""A scene in; everything that is rendered of it out: wearer, rig, simulated motion, surroundings.

The scene is resolved here once; later stages take the result.
"""
