"""Visual odometry of a rig: grey pictures of all views in; head poses, a map of points, gaps out.

Works on unit rays in the head frame, with any lens. Nothing here reads files or knows of truth.
"""
