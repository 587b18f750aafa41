"""Detections in every view, and optionally images, in; a track of 37 joint angles a frame out.

`tracker` works on whole recordings, `online` on one frame after another.
"""
