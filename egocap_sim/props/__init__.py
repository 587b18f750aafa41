"""A scene's things and the wearer's motion in; moving and standing objects as actors out.

A new kind of thing is one module and one line in `registry`.
"""
