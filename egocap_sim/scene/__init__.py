"""Scene files in; checked settings and sampled rigs out.

`config` is the schema of a scene file; a new key is one field there.
"""
