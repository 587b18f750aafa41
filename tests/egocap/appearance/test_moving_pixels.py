"""Pixels that move against a room, in drawn pictures of a body before one that turns."""

import numpy as np

from egocap.appearance.moving_pixels import MovingPixels
from egocap.appearance.surface_points import SurfacePoints
from egocap.image_model.image_rays import image_rays
from egocap.image_model.model import ImageModel
from tests.egocap.appearance.test_surface_points import BODY, POSE, RIG, STILL, TURN, bent, pictures

RAYS = image_rays(RIG, 64, 64)
MODEL = ImageModel(BODY, RAYS)
FOREARM = np.array([part in ("right_forearm", "right_hand") for part in BODY.parts])


def moved(pose, turn, room=STILL):
    """Motion along the rays from the first picture to one of another pose, the room turned."""
    points = SurfacePoints(RIG, BODY)
    points.follow(pictures(POSE, room)[0], POSE)
    points.follow(pictures(pose, turn @ room)[0], POSE)
    beside = MODEL.visibility(POSE).sum(1) < 0.05
    moving = MovingPixels(points.rig, RAYS)
    return moving.measure(points.before, points.grey, turn, beside), beside


def test_a_bent_elbow_moves_its_pixels_and_no_others():
    found, beside = moved(bent(8.0), STILL)
    forearm = MODEL.visibility(POSE)[:, FOREARM].sum(1) > 0.9
    assert (found[forearm] > 0.0).mean() > 0.3
    assert found[forearm].mean() > 20.0 * found[beside].mean()


def test_a_room_that_turns_does_not_move_and_what_stays_on_the_rig_neither():
    found, beside = moved(POSE, TURN)
    assert (found[beside] > 0.0).mean() < 0.05
    assert (found[~beside] > 0.0).mean() < 0.1
    wrong, _ = moved(POSE, STILL)
    assert (wrong == 0.0).all()
