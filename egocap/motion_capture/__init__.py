"""Footage of a rig's cameras in; the wearer's motion, a film and a page of findings out.

One stage a module, each of which writes a file that other commands read; `capture` runs them all.
"""
