"""What successive pictures tell of a body without a detector.

What lies behind it and in which light, which pixels move against the room, points on its surface,
and where an arm may be that was lost.
"""
