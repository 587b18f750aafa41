"""Sequences in; the formats of other tools, and contact sheets, out.

`formats` names what writes each format.
"""
