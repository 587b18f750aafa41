"""Tracks of an average person, with head poses and contacts."""

import numpy as np

from egocap.body.kinematics import label_positions
from egocap.body.proportions import Proportions
from egocap.data.track import Track
from egocap.geometry import rigid, transform

FPS = 30.0
BODY = Proportions.from_lengths(1.75)


def track_of(angles, heads, contacts=None) -> Track:
    """A track of an average person."""
    frames = len(angles)
    joints = label_positions(BODY, angles)
    return Track(
        np.arange(frames) / FPS, angles, joints, np.zeros(frames), np.ones(frames, bool),
        np.full(frames, 36.0), 0.01, {}, offsets=BODY.offsets, T_world_head=heads,
        joints_world=transform(heads, joints),
        contacts=np.ones((frames, 4)) if contacts is None else contacts,
    )  # fmt: skip


def standing(frames=45, height=1.6):
    """Angles and head poses of a person who stands still."""
    return np.zeros((frames, 37)), rigid(np.tile(np.eye(3), (frames, 1, 1)), [0.0, 0.0, height])
