"""Adaptation of the detector to a user's own footage, without annotations.

Recordings go in; labels where the offline tracker is sure, and weights trained on them, come out.
"""
