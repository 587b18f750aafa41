"""Sequences in; counts of what they contain, and one HTML page of them, out.

They are read one by one: memory does not grow with their number.
"""
