"""A place's settings in; its static meshes, light and background out.

A new place is one function in `rooms` or `grounds` and one line in `places`.
"""
