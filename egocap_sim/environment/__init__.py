"""The name of a place and a random generator in; static meshes, light and background out.

A new place is one function in `rooms` or `grounds` and one entry in `places`.
"""
