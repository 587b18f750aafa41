"""Files in; sequences, data sets, detections and tracks out, and the same back to disk.

Every file format of the pipeline is read and written here. Nothing here knows how poses are found.
"""
