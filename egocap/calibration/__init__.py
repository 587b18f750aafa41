"""Pictures of a calibration board in; calibrated cameras, their rig and its uncertainty out.

Corners come from OpenCV's detectors and rectified patches, the adjustment is our own.
"""
