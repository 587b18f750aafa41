"""Motions of people in; how they hold their heads over whole recordings, for doubting rigs, out.

The comparison of a track with its inputs is `egocap.track.consistency`.
"""
