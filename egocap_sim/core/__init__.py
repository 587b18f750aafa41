"""What every room of the simulator needs: body names, random streams, resources, trajectories.

Plain values without rendering or physics.
"""
