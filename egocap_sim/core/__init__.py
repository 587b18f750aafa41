"""Shared by the whole simulator: body names, random generators, resources, trajectories, the cache.

Plain values without rendering or physics.
"""
