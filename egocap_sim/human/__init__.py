"""A seed and settings in; a dressed person out.

`body` makes surface and skeleton, `clothing` dresses them.
`clothing.wardrobe.make_person` is the way in.
"""
