"""A drawn pose: over the joints it belongs to, and upright in space."""

import numpy as np

from egocap.body.labels import LABEL_INDEX
from egocap.body.side_colours import LEFT, RIGHT
from egocap.view.skeleton import DIMMED, GREY, draw_in_space, draw_pose, side_by_side
from tests.egocap.conftest import make_motion


def near(image, pixel, colour):
    """Whether a colour is found within 3 pixels of a place."""
    x, y = np.rint(pixel).astype(int)
    patch = image[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4].astype(int)
    return bool((np.abs(patch - colour).sum(-1) < 60).any())


def test_the_pose_lies_on_the_joints_of_each_view():
    made = make_motion(frames=1)
    height = 256
    black = [np.zeros((camera.height, camera.width, 3), np.uint8) for camera in made.rig.cameras]
    sure = np.ones(18)
    canvas = side_by_side(black, made.joints[0], sure, made.rig, height)
    pixels, inside = made.rig.project(made.joints[0])
    width = round(made.rig.cameras[0].width * height / made.rig.cameras[0].height / 2) * 2
    assert canvas.shape == (height, 2 * width + height, 3)
    drawn = 0
    for v in range(2):
        panel = canvas[:, v * width : (v + 1) * width]
        for name, colour in (("left_hand", LEFT), ("right_hand", RIGHT)):
            j = LABEL_INDEX[name]
            if inside[v, j]:
                assert near(panel, (pixels[v, j] + 0.5) * height / 512 - 0.5, colour), (v, name)
                drawn += 1
    assert drawn >= 2


def test_a_missing_picture_is_black_and_unsure_joints_are_darker():
    made = make_motion(frames=1)
    canvas = side_by_side([None, None], made.joints[0], np.zeros(18), made.rig, 128)
    assert not (np.abs(canvas.astype(int) - LEFT).sum(-1) < 30).any()
    assert (np.abs(canvas - DIMMED * np.array(LEFT)).sum(-1) < 30).any()


def test_without_confidence_a_pose_is_grey():
    image = np.zeros((50, 50, 3), np.uint8)
    points = np.random.default_rng(0).uniform(5.0, 45.0, (18, 2))
    draw_pose(image, points, np.ones(18, bool), None)
    assert (image == GREY).all(-1).any() and (image == image[..., :1]).all()


def test_in_space_the_head_is_up_and_left_is_on_the_right_seen_from_before():
    made = make_motion(frames=1)
    picture = np.zeros((200, 200, 3), np.uint8)
    draw_in_space(picture, made.joints[0], np.ones(18))
    picture = picture.astype(int)
    rows = {}
    for side, colour in (("left", LEFT), ("right", RIGHT)):
        rows[side] = np.argwhere(np.abs(picture - colour).sum(-1) < 60)
        assert len(rows[side]) > 30
    assert rows["left"][:, 1].mean() > rows["right"][:, 1].mean()
    pale = np.argwhere((picture > 200).all(-1))
    assert pale[:, 0].min() < rows["left"][:, 0].max() - 80


def test_joints_outside_are_not_drawn():
    image = np.zeros((50, 50, 3), np.uint8)
    points = np.full((18, 2), 25.0)
    draw_pose(image, points, np.zeros(18, bool), np.ones(18))
    assert not image.any()
    draw_pose(image, points, np.ones(18, bool), np.ones(18))
    assert image.any()
