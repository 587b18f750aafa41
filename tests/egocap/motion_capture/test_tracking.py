"""Windows cover every frame; joined tracks are as smooth as the motion."""

from itertools import pairwise
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from egocap.body.skeleton import forward
from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.head_pose.map_poses import overlapping
from egocap.motion_capture import tracking
from egocap.motion_capture.tracking import OVERLAP, WINDOW, join, reduced_images
from egocap.pose.config import TrackerConfig
from tests.egocap.conftest import make_motion


@pytest.mark.parametrize("frames", [1, 500, WINDOW + OVERLAP, WINDOW + OVERLAP + 1, 5000, 54000])
def test_windows_cover_all_frames_and_overlap(frames):
    windows = overlapping(frames, WINDOW, OVERLAP)
    assert windows[0].start == 0 and windows[-1].stop == frames
    assert all(a.stop - b.start == OVERLAP for a, b in pairwise(windows))
    assert max(map(len, windows)) <= WINDOW + OVERLAP
    assert len(windows) == 1 or min(map(len, windows)) > WINDOW / 2


@pytest.mark.parametrize(("size", "most"), [(64, 0), (16, 2)])
def test_reduced_images_are_those_of_the_whole_ones(tiny_sequence, size, most):
    """Of a JPEG, whose half is decoded for the smaller ones, to a rounding error or two."""
    sequence = Sequence(tiny_sequence)
    for i in range(2):
        for found, image in zip(reduced_images(sequence, i, size), sequence.images(i), strict=True):
            whole = cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA)
            assert np.abs(found.astype(int) - whole).max() <= most


def test_joined_windows_are_the_motion():
    made = make_motion(frames=2000)
    windows = overlapping(2000, WINDOW, OVERLAP)

    def part(window, error):
        rows = slice(window.start, window.stop)
        angles = made.angles[rows] + error
        count = len(window)
        return Track(
            times=made.times[rows], angles=angles, joints_head=forward(made.person, angles),
            energy=np.arange(count, dtype=float) + window.start, converged=np.ones(count, bool),
            detections_used=np.ones(count), seconds_per_frame=0.1, config={},
            offsets=made.person.offsets, confidence=np.ones((count, 18)),
        )  # fmt: skip

    whole = join(windows, [part(w, 0.01 * i) for i, w in enumerate(windows)], made.person)
    np.testing.assert_array_equal(whole.times, made.times)
    np.testing.assert_array_equal(whole.energy, np.arange(2000))
    off = whole.angles - made.angles
    assert off[0, 0] == 0 and np.isclose(off[-1, 0], 0.01 * (len(windows) - 1))
    assert np.abs(np.diff(off, axis=0)).max() < 1.6 * 0.01 / OVERLAP  # of a smooth ramp
    np.testing.assert_allclose(whole.joints_head, forward(made.person, whole.angles))
    assert whole.offsets.shape == (22, 3)


def test_the_check_of_joined_windows_uses_the_estimated_rotations(motion, monkeypatch):
    class Pool:
        def __init__(self, workers):
            self.map = map

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

    def track(folder, rig, found, first, body, config, heads):
        rows, count = slice(first, first + len(found.times)), len(found.times)
        return Track(
            times=found.times, angles=motion.angles[rows], joints_head=motion.joints[rows],
            energy=np.zeros(count), converged=np.ones(count, bool), detections_used=np.ones(count),
            seconds_per_frame=0.1, config={"estimated": {"rotation_deg": turns}},
            offsets=body.offsets,
        )  # fmt: skip

    turns = [[0.0, 0.0, 0.0], [0.0, 0.0, 90.0]]
    monkeypatch.setattr(tracking, "WINDOW", 40)
    monkeypatch.setattr(tracking, "OVERLAP", 10)
    monkeypatch.setattr(tracking, "WorkerPool", Pool)
    monkeypatch.setattr(tracking, "Sequence", lambda folder: SimpleNamespace(rig=motion.rig))
    monkeypatch.setattr(tracking, "_track", track)
    monkeypatch.setattr(tracking, "with_consistency", lambda track, found, rig, *_: rig)
    found = motion.detect("simulated:1.0")
    rig = tracking.track_in_windows("", found, motion.person, TrackerConfig())
    left, right = (mount.T_head_camera[:3, :3] for mount in motion.rig.mounts)
    np.testing.assert_allclose(rig.mounts[0].T_head_camera[:3, :3], left)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(rig.mounts[1].T_head_camera[:3, :3], quarter @ right, atol=1e-12)
