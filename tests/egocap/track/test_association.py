"""Which of a detector's places is taken: sides exchanged back, modes by the body's fit."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX, MIRROR
from egocap.pose import kernel
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import observe
from egocap.track.association import associate, needs_association
from egocap.track.tracker import Tracker

CONFIG = TrackerConfig()
LEGS = [LABEL_INDEX[f"{s}_{p}"] for s in ("left", "right")
        for p in ("hip", "knee", "ankle", "foot")]  # fmt: skip


def swapped(found, labels, frames, view=0):
    """Detections with the sides of some labels exchanged in one view."""
    points = found.points.copy()
    partners = [MIRROR[label] for label in labels]
    points[frames, view, labels] = found.points[frames, view, partners]
    return replace(found, points=points)


def test_exchanged_sides_are_put_back(motion):
    exact = motion.detect("simulated:1")
    proposed = observe(swapped(exact, LEGS, 7), motion.rig, motion.person, CONFIG)
    straight = observe(exact, motion.rig, motion.person, CONFIG)
    model, taken = kernel.make_model(motion.person, CONFIG), proposed[:]
    assert associate(motion.angles, proposed, taken, model, CONFIG) == 1
    assert np.allclose(taken.rays, straight.rays)
    assert not np.allclose(proposed.rays, straight.rays)  # the proposal itself stays
    assert associate(motion.angles, proposed, taken, model, CONFIG) == 0


def test_switched_off_nothing_is_exchanged(motion):
    config = TrackerConfig(fix_swaps=False)
    proposed = observe(
        swapped(motion.detect("simulated:1"), LEGS, 7), motion.rig, motion.person, config
    )
    assert not needs_association(proposed, config)
    taken = proposed[:]
    associate(motion.angles, proposed, taken, kernel.make_model(motion.person, config), config)
    assert np.array_equal(taken.rays, proposed.rays)


def with_modes(motion):
    """The right knee of one view is far off, and its true place the second mode."""
    exact = motion.detect("simulated:1")
    knee = LABEL_INDEX["right_knee"]
    points = exact.points.copy()
    points[:, 1, knee] += (120.0, -60.0)
    modes = np.stack([points, np.full_like(points, np.nan)], -2)
    modes[:, 1, knee, 1] = exact.points[:, 1, knee]
    weights = np.stack([exact.valid * 1.0, np.zeros(exact.valid.shape)], -1)
    weights[:, 1, knee] = np.where(exact.valid[:, 1, knee, None], (0.6, 0.4), 0.0)
    return exact, replace(exact, points=points, modes=modes, mode_weights=weights), knee


def test_the_mode_that_the_body_fits_is_taken(motion):
    exact, found, knee = with_modes(motion)
    proposed = observe(found, motion.rig, motion.person, CONFIG)
    straight = observe(exact, motion.rig, motion.person, CONFIG)
    taken = proposed[:]
    associate(motion.angles, proposed, taken, kernel.make_model(motion.person, CONFIG), CONFIG)
    seen = exact.valid[:, 1, knee]
    assert np.allclose(taken.rays[seen, 1, knee], straight.rays[seen, 1, knee])
    others = [j for j in range(18) if j != knee]
    assert np.array_equal(taken.rays[:, :, others], proposed.rays[:, :, others])


@pytest.mark.parametrize("smoothing", ["interval", "none"])
def test_swaps_and_strangers_hardly_harm_the_track(motion, smoothing):
    source = "simulated:2,swaps=0.15,wrong=0.1,modes=1"
    found = motion.detect(source, hidden=0.2, seed=3)
    off, on = (
        motion.errors(
            Tracker(
                motion.rig, motion.person,
                TrackerConfig(smoothing=smoothing, use_modes=choosing, fix_swaps=choosing),
            ).track(found)
        ).mean()
        for choosing in (False, True)
    )  # fmt: skip
    assert on < off
    clean = Tracker(motion.rig, motion.person, TrackerConfig(smoothing=smoothing)).track(
        motion.detect("simulated:2", hidden=0.2, seed=3)
    )
    assert on < 1.5 * motion.errors(clean).mean()
