"""Folders of motion clips in; training, validation and test sets out, and the log of test runs.

The sets are data (`motion_sets.toml`): file names of clips, and seeds of people, rooms and rigs.
"""
