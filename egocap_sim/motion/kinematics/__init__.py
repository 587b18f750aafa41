"""Joint rotations and targets in; posed figures out: forward and inverse kinematics.

Everything is on the 21 bodies of `core.bodies`; nothing here reads files.
"""
