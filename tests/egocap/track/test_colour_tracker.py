"""A body followed by its appearance through pictures that the model itself draws."""

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap.body.skeleton import DOF_INDEX, forward
from egocap.errors import InputError
from egocap.image_model.colour_term import ColourTermConfig
from egocap.track.colour_tracker import ColourTracker
from tests.egocap.image_model.test_palette import GREY, PERSON, POSE, RIG, picture

SMALL = RIG.resized(40, 40)
TERM = ColourTermConfig(size=40, weight=0.03)
ELBOWS = [DOF_INDEX["left_elbow_flexion"], DOF_INDEX["right_elbow_flexion"]]
ARMS = [3, 4, 7, 8]  # elbows and wrists
WRIST = LABEL_INDEX["left_wrist"]


def motion(frames=10):
    """Poses whose elbows bend by 3 degrees a frame."""
    poses = np.tile(POSE, (frames, 1))
    poses[:, ELBOWS] += np.deg2rad(3.0) * np.arange(frames)[:, None]
    return poses


@pytest.fixture(scope="module")
def clip():
    poses = motion()
    return poses, [picture(GREY, pose) for pose in poses]


def test_arms_are_followed(clip):
    poses, pictures = clip
    tracker = ColourTracker(SMALL, PERSON, POSE, TERM)
    found = [p for t, images in enumerate(pictures) for p in tracker.step(images, t / 30)]
    last = found[-1]
    error = np.linalg.norm(last.joints_head - forward(PERSON, poses[-1]), axis=-1)[ARMS]
    still = np.linalg.norm(forward(PERSON, POSE) - forward(PERSON, poses[-1]), axis=-1)[ARMS]
    assert still.max() > 0.1
    assert error.mean() < 0.5 * still.mean()
    assert last.confidence[ARMS].mean() > 0.5
    assert ((last.confidence >= 0.0) & (last.confidence <= 1.0)).all()
    assert [p.time for p in found] == [t / 30 for t in range(10)]


def test_a_missing_picture_leaves_the_pose(clip):
    _, pictures = clip
    tracker = ColourTracker(SMALL, PERSON, POSE, TERM)
    with pytest.raises(InputError, match="no first picture"):
        tracker.step([pictures[0][0], None], 0.0)
    tracker = ColourTracker(SMALL, PERSON, POSE, TERM)
    tracker.learn(pictures[0])
    (first,) = tracker.step(pictures[1], 0.1)
    (blind,) = tracker.step([None, pictures[2][1]], 0.2)
    assert np.array_equal(first.angles, blind.angles) and not blind.converged
    assert (blind.confidence <= first.confidence + 1e-9).all()
    with pytest.raises(InputError, match=r"after one of 0\.2 s"):
        tracker.step(pictures[2], 0.2)


def test_an_arm_that_jumps_is_found_again():
    """Between two frames an arm goes where no descent finds it; the search does."""
    there = POSE.copy()
    there[DOF_INDEX["left_shoulder_raise"]] -= np.deg2rad(45.0)
    there[DOF_INDEX["left_elbow_flexion"]] += np.deg2rad(60.0)
    tracker = ColourTracker(SMALL, PERSON, POSE, TERM)
    wrist, off = forward(PERSON, there)[WRIST], []
    for t in range(14):
        (pose,) = tracker.step(picture(GREY, POSE if t == 0 else there), t / 30)
        off.append(float(np.linalg.norm(pose.joints_head[WRIST] - wrist)))
    assert off[0] > 0.25
    assert off[-1] < 0.1, off
