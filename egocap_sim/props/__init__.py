"""A scene's props and the wearer's motion in; moving and standing objects as actors out.

A new kind of prop is one function and one entry in `registry`.
"""
