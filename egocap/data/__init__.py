"""Files in; sequences, data sets, detections and tracks out, and back to files.

Every file format of the pipeline is read and written here; pose estimation is elsewhere.
"""
