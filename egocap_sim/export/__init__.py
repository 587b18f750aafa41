"""Sequences in; the formats of other tools, and contact sheets, out.

`formats` finds the writer of each format by its name.
"""
