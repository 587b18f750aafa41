"""Meshes, poses and cameras in; fisheye images, part labels and depth out, by OpenGL.

`gl` is the one module that imports pyrender and PyOpenGL.
"""
