"""Colour joins a track: held by what is known, and refused without images."""

import numpy as np
import pytest

from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.track.colour_refinement import most_certain_frames
from egocap.track.tracker import Tracker


def test_surest_frames_are_spread_over_the_track():
    spread = np.tile([3.0, 1.0, 2.0], 5)
    covariances = spread[:, None, None] * np.eye(37)
    assert most_certain_frames(covariances, 5) == [1, 4, 7, 10, 13]
    assert most_certain_frames(covariances[:2], 5) == [0, 1]


def test_colour_needs_images_and_covariance(motion):
    found = motion.detect("simulated:2")
    with pytest.raises(InputError, match="without images"):
        Tracker(motion.rig, motion.person, TrackerConfig(colour=True)).track(found)
    with pytest.raises(InputError, match="without covariance"):
        TrackerConfig(colour=True, covariance=False)


def test_a_featureless_image_moves_little(motion):
    from dataclasses import replace

    found = motion.detect("simulated:2")
    few = {n: getattr(found, n)[:4] for n in ("times", "points", "sigma", "confidence", "valid")}
    found = replace(found, **few)
    grey = np.full((512, 640, 3), 128, np.uint8)
    config = TrackerConfig(colour=True, colour_size=16)
    plain = Tracker(motion.rig, motion.person).track(found)
    coloured = Tracker(motion.rig, motion.person, config).track(found, lambda t: (grey, grey))
    assert np.isfinite(coloured.joints_head).all()
    moved = np.linalg.norm(coloured.joints_head - plain.joints_head, axis=-1)
    assert np.median(moved) < 0.02
    assert {"palette", "colour"} <= set(coloured.config["seconds"])
