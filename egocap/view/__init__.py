"""Images, poses and the image model in; overlays, live pages and videos out.

Nothing here changes a result.
"""
