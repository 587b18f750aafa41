"""A canonical clip and a person in; a reference motion on that person's bones and floor out.

Feet that the clip plants are planted on the person's own ground.
"""
