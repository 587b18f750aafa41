"""Labels from tracks: near the truth, and left out where the track may err."""

from dataclasses import replace

import numpy as np
import pytest

import egocap
from egocap.adaptation.labels import at_picture_times, tracked_labels
from egocap.body.labels import LABEL_INDEX
from egocap.data.footage import FrameTimes
from egocap.detect.train.examples import HIDDEN, OUTSIDE, SEEN, UNKNOWN
from egocap.errors import InputError
from egocap.series import interpolate

HAND, FRAMES = LABEL_INDEX["right_hand"], slice(30, 60)


@pytest.fixture(scope="module")
def tracked(motion):
    """Detections of a motion, its track, and where the joints are in the images."""
    found = motion.detect("simulated:2", hidden=0.1)
    track = egocap.Tracker(motion.rig, motion.person).track(found)
    return found, track, np.moveaxis(motion.rig.project(motion.joints)[0], 0, 1)


def moved(found, views):
    """A hand detected elsewhere for a second, with certainty."""
    points = found.points.copy()
    points[FRAMES, views, HAND] += (60.0, -40.0)
    return replace(found, points=points)


def distance(labels, truth):
    return np.where(labels.known, np.linalg.norm(labels.points - truth, axis=-1), np.nan)


def test_labels_are_nearer_to_the_truth_than_detections(motion, tracked):
    found, track, truth = tracked
    labels = tracked_labels(track, found, motion.rig)
    assert labels.known.mean() > 0.6
    both = labels.known & found.valid
    before = np.linalg.norm(found.points - truth, axis=-1)[both]
    after = distance(labels, truth)[both]
    assert np.sqrt(np.mean(after**2)) < 0.9 * np.sqrt(np.mean(before**2))
    assert np.isin(labels.state, (SEEN, HIDDEN, OUTSIDE, UNKNOWN)).all()
    assert not (labels.corrected & ~labels.known).any()


def test_a_wrong_detection_in_one_view_is_corrected_from_the_other(motion, tracked):
    found, track, truth = tracked
    right = tracked_labels(track, found, motion.rig)
    sure = right.known[FRAMES, 0, HAND] & (right.state[FRAMES, 1, HAND] == SEEN)
    sure &= found.valid[FRAMES, 0, HAND]
    assert sure.sum() > 10
    labels = tracked_labels(track, moved(found, [0]), motion.rig)
    held = labels.known[FRAMES, 0, HAND] & sure
    assert held.sum() > 0.8 * sure.sum()
    assert labels.corrected[FRAMES, 0, HAND][held].all()
    assert (labels.state[FRAMES, 0, HAND][held] == HIDDEN).all()
    assert np.median(distance(labels, truth)[FRAMES, 0, HAND][held]) < 6.0


def test_labels_are_where_joints_are_when_a_picture_is_taken(motion, tracked):
    found, track, truth = tracked
    taken = np.stack([track.times, track.times + 0.016], 1)  # half a frame apart
    taken[-1] = track.times[-1]
    present = np.ones(taken.shape, bool)
    present[:5, 1] = False
    times = FrameTimes(track.times, taken, np.zeros(taken.shape, int), present)
    labels = tracked_labels(track, found, motion.rig)
    moved = at_picture_times(labels, track, motion.rig, times)
    assert np.array_equal(moved.points[:, 0], labels.points[:, 0])
    assert np.array_equal(moved.points[:5], labels.points[:5])
    then = motion.rig.project(interpolate(taken[:, 1], track.times, motion.joints))[0][1]
    known = labels.known[5:, 1]
    before, after, own = (
        np.linalg.norm(a - b, axis=-1)[5:][known]
        for a, b in ((labels.points[:, 1], then), (moved.points[:, 1], then),
                     (labels.points[:, 1], truth[:, 1]))
    )  # fmt: skip
    assert np.percentile(after, 95) < 1.05 * np.percentile(own, 95)
    assert np.percentile(before, 95) > 1.3 * np.percentile(own, 95)


def test_detections_that_are_wrong_in_all_views_give_no_label(motion, tracked):
    found, track, _ = tracked
    labels = tracked_labels(track, moved(found, [0, 1]), motion.rig)
    assert not labels.known[FRAMES, :, HAND].any()


def test_an_unsure_track_gives_no_labels(motion, tracked):
    found, track, _ = tracked
    labels = tracked_labels(replace(track, covariance=400.0 * track.covariance), found, motion.rig)
    assert not labels.known.any()


def test_tracks_that_do_not_fit_are_refused(motion, tracked):
    found, track, _ = tracked
    with pytest.raises(InputError, match="without covariance"):
        tracked_labels(replace(track, covariance=None), found, motion.rig)
    with pytest.raises(InputError, match="frames and views"):
        tracked_labels(track, found[:10], motion.rig)
