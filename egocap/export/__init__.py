"""Tracks in; files for biomechanics, animation and tables out.

A format is one module and one line of `formats`; BVH, which other rooms write too, is in `data`.
"""
