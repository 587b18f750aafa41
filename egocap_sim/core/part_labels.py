"""Part labels drawn into every view: which body of which person, or which kind of thing.

0 is background (nothing drawn: sky). 1..21 are the wearer's bodies in the order of
`bodies.BODIES`, skin or cloth alike. 40 is the rig or helmet. 100 is the room (floor,
walls), 101 furniture and other static things, 102 objects in hand, 200 other people.
"""

from __future__ import annotations

from egocap_sim.core.bodies import INDEX

BACKGROUND = 0
WEARER_FIRST, WEARER_LAST = 1, 21
RIG = 40
ROOM = 100
FURNITURE = 101
OBJECT = 102
OTHER_PERSON = 200


def wearer_part(body: str) -> int:
    """Part label of one of the wearer's bodies."""
    return WEARER_FIRST + INDEX[body]
