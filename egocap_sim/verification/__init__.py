"""A sequence on disk in; a list of what is damaged or inconsistent out.

`crosscheck` recomputes the truth from pixels, rays and forces.
"""
