"""Recordings with their truth in; contacts learned, and scores of the motion in the world out.

Edit here how the contact network is learned and how motion in the world is measured.
"""
