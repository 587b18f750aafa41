"""A scene in; its wearer, rig, simulated motion and surroundings out.

The scene is resolved here once; recording and checks use the `World`.
"""
