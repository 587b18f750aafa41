"""Sequences in; statistics of their content, and one HTML page of them, out.

One sequence is in memory at a time.
"""
