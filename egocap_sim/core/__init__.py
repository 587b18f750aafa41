"""Shared by the whole simulator: body names, random generators, resources, trajectories.

Plain values without rendering or physics.
"""
