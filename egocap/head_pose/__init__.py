"""Where the head is in the world: a sequence, or a trajectory of another program, in; poses out.

Poses have z up and, where the floor is known, height 0 on it. Frames without a pose are left out.
"""
