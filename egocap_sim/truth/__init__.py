"""A simulated motion and what was rendered in; joints, visibility and contacts per frame out.

`raycast` is a second, independent test of visibility.
"""
