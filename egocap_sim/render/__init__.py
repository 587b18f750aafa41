"""Meshes, poses and cameras in; fisheye images, part labels and depth out, by OpenGL.

`egl` prepares PyOpenGL before its first import; other modules take `GL` from `gl`.
"""
