"""A scene's other people in; bystanders that walk, stand and greet as actors out.

Their motion is played back, not simulated.
"""
