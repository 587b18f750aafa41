"""Files and folders on object stores by their addresses, such as s3://bucket/walk.

Commands and libraries work on local files: an address is replaced by a local copy, which is fetched
before it is read and sent when it is written. By fsspec.
"""
