"""Sizes, colours and random generators in; textured meshes and actors out.

A new piece of furniture or texture is one function and one entry of its table.
"""
