"""The simulated world: people, physics and fisheye footage with exact truth."""
