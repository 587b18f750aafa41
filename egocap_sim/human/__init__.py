"""A seed and settings in; a dressed person out.

`body` makes the surface and skeleton, `clothing` dresses them.
Call `clothing.wardrobe.make_person`.
"""
