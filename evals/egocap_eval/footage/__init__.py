"""Footage of ordinary cameras: exported from simulated sequences, imported and captured again.

The exports' planted clocks and the sequences' truth are used for scores alone.
"""
