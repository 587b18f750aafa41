"""BVH and npz files in; cleaned, canonical clips out.

A new naming convention is one row of a table in `skeleton_names`.
"""
