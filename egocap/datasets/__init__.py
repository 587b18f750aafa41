"""Published data sets of egocentric pose in, read in place; recordings with their labels out.

One module a family of layouts; `catalogue` finds it by name. Files are never executed or unpickled.
"""
