"""A rig and a calibration board in; pictures of the board before the rig, and the truth, out.

Every pixel casts the camera's own rays on the board; nothing is shared with the calibration.
"""
