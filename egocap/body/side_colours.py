"""The colours of left, right and middle body parts in every picture, page and export.

Blue and vermilion remain distinct for people with any common colour vision deficiency.
Source: Okabe & Ito 2008, "Color universal design".
"""

from __future__ import annotations

LEFT, RIGHT, MIDDLE = (86, 180, 233), (213, 94, 0), (235, 235, 235)
"""RGB on pictures and dark pages."""
INK = (75, 85, 99)
"""RGB of the middle on white pages."""


def side_colour(name: str, middle: tuple[int, int, int] = MIDDLE) -> tuple[int, int, int]:
    """RGB of a body part or label by its side, e.g. 'left_wrist' or 'l_hand'."""
    side = name.partition("_")[0]
    return {"left": LEFT, "l": LEFT, "right": RIGHT, "r": RIGHT}.get(side, middle)


def side_hex(name: str) -> str:
    """The same for white pages, as '#rrggbb'."""
    return "#{:02x}{:02x}{:02x}".format(*side_colour(name, INK))
