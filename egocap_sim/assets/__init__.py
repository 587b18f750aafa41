"""Sizes, colours and seeds in; textured meshes out.

Primitives, procedural textures, furniture, and the actors that carry meshes through a recording.
"""
