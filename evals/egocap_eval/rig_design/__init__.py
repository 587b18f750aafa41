"""Sweeps of rigs in; visibility, Cramer-Rao bounds, tracked errors and a recommendation out.

`rig` is the study; a new measure of a rig is one function in `rig_bounds`.
"""
