"""The description of a calibration board in; its corners, shapes and a printable sheet out.

A new kind of board is one entry of `board.KINDS`.
"""
