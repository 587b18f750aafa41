"""A sequence on disk in; a list of its damages and inconsistencies out.

`crosscheck` recomputes the truth from pixels, rays and forces.
"""
