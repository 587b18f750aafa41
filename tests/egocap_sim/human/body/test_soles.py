import numpy as np

from egocap_sim.core.bodies import BODIES, FEET, INDEX
from egocap_sim.human.body.soles import foot_yaw, sole_points, soles


def test_boxes_stand_on_the_floor_at_rest(stand_in):
    points = sole_points(stand_in, stand_in.joints[None], np.tile(np.eye(3), (1, 21, 1, 1)))[0]
    np.testing.assert_allclose(points[..., 2], 0.0, atol=1e-12)


def test_boxes_are_ordered_and_turned_like_the_feet(stand_in):
    boxes = soles(stand_in)
    assert tuple(box.body for box in boxes) == FEET
    yaws = [foot_yaw(stand_in, side) for side in "llrr"]
    np.testing.assert_allclose([box.yaw for box in boxes], yaws)
    assert yaws[0] > 0.1 > -0.1 > yaws[2]  # feet turned out


def test_boxes_cover_the_skin_of_the_feet(stand_in):
    for box in soles(stand_in):
        body = INDEX[box.body]
        mine = stand_in.body_owner == body
        inside = (stand_in.body_vertices[mine] - stand_in.joints[body] - box.centre) @ box.rotation
        share = (np.abs(inside[:, :2]) <= box.half[:2] + 1e-3).all(1).mean()
        assert share > 0.75


def test_boxes_of_foot_and_toes_meet_under_the_ball(stand_in):
    foot, toe = soles(stand_in)[:2]
    at = stand_in.joints
    front = at[INDEX["l_foot"]] + foot.centre + foot.rotation @ (foot.half * [1, 0, 0])
    back = at[INDEX["l_toe"]] + toe.centre - toe.rotation @ (toe.half * [1, 0, 0])
    along = foot.rotation[:, 0]
    assert abs((front - back) @ along) < 1e-9


def test_points_follow_their_bodies(stand_in):
    R = np.tile(np.eye(3), (1, len(BODIES), 1, 1))
    moved = stand_in.joints[None] + [1.0, -2.0, 0.5]
    still = sole_points(stand_in, stand_in.joints[None], R)
    np.testing.assert_allclose(sole_points(stand_in, moved, R) - still, [[[[1.0, -2.0, 0.5]]]] *
                               np.ones_like(still), atol=1e-12)  # fmt: skip
