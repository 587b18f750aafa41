"""A motion and head poses in; contacts, the ground and the energy of both out.

Edit here what touches the ground, how the ground is learned, and the terms that hold feet in place.
"""
