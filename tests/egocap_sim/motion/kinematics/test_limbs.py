import hypothesis.strategies as st
import numpy as np
from hypothesis import given, settings

from egocap.geometry import axis_angle
from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.limbs import bend_limb, shortest_arc


def _crouch(bend: float) -> np.ndarray:
    R = np.tile(np.eye(3), (1, 21, 1, 1))
    for s in ("l", "r"):
        R[0, INDEX[f"{s}_thigh"]] = axis_angle(np.array([0.0, -1.0, 0.0]), bend)
        R[0, INDEX[f"{s}_calf"]] = axis_angle(np.array([0.0, 1.0, 0.0]), bend)
    return R


@settings(deadline=None, max_examples=60)
@given(
    st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    st.floats(0.7, 1.0),
    st.sampled_from("lr"),
)
def test_ankle_goes_where_it_is_sent(move, bend, side):
    R = _crouch(bend)
    P = figure.positions(R, np.zeros((1, 3)))
    new_R = bend_limb(P, R, side, np.array([move]))
    new_P = figure.positions(new_R, np.zeros((1, 3)))
    foot = INDEX[f"{side}_foot"]
    np.testing.assert_allclose(new_P[0, foot], P[0, foot] + move, atol=1e-9)
    moved = {f"{side}_{part}" for part in ("calf", "foot", "toe")}
    others = [i for name, i in INDEX.items() if name not in moved]
    np.testing.assert_allclose(new_P[0, others], P[0, others], atol=1e-12)
    np.testing.assert_allclose(new_R[0, foot], R[0, foot])
    np.testing.assert_allclose(new_R @ np.swapaxes(new_R, -1, -2), np.broadcast_to(
        np.eye(3), new_R.shape), atol=1e-9)  # fmt: skip


def test_ankle_out_of_reach_goes_as_far_as_it_can():
    R = np.tile(np.eye(3), (1, 21, 1, 1))
    P = figure.positions(R, np.zeros((1, 3)))
    new_P = figure.positions(bend_limb(P, R, "l", np.array([[0.0, 0.0, -0.5]])), np.zeros((1, 3)))
    leg = figure.THIGH + figure.CALF
    reach = np.linalg.norm(new_P[0, INDEX["l_foot"]] - new_P[0, INDEX["l_thigh"]])
    assert 0.99 * leg < reach < leg + 1e-9


def test_straight_knee_bends_forwards():
    R = np.tile(np.eye(3), (1, 21, 1, 1))
    P = figure.positions(R, np.zeros((1, 3)))
    new_P = figure.positions(bend_limb(P, R, "r", np.array([[0.0, 0.0, 0.2]])), np.zeros((1, 3)))
    assert new_P[0, INDEX["r_calf"], 0] > P[0, INDEX["r_calf"], 0] + 0.1


def test_shortest_arc_turns_one_into_the_other():
    rng = np.random.default_rng(1)
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 50, 3)))
    R = shortest_arc(a, b)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", R, a), b, atol=1e-12)
    angle = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))
    np.testing.assert_allclose(angle, np.arccos((a * b).sum(1)), atol=1e-7)
