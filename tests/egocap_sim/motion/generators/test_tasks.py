"""Seated at a desk: the pelvis stays on the seat, the hands above the top, the knees below."""

import numpy as np
import pytest

from egocap.errors import InputError
from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.generators.postures import SEAT_TO_PELVIS
from egocap_sim.motion.generators.registry import make_motion
from egocap_sim.motion.generators.tasks import TASKS
from egocap_sim.motion.kinematics.limbs import bend_angle
from egocap_sim.motion.retarget.retarget import retarget, sample_reference
from egocap_sim.props.performance import Performance
from egocap_sim.props.registry import make_prop
from egocap_sim.scene.config import MotionTable, ThingTable


@pytest.mark.parametrize("task", TASKS)
def test_sits_with_the_hands_over_the_top(task):
    clip = make_motion("desk", 8.0, np.random.default_rng(1), tasks=(task,), seat=0.45)
    p = clip.positions
    np.testing.assert_allclose(p[:, 0, 2], 0.45 + SEAT_TO_PELVIS, atol=0.02)
    hands = p[:, [INDEX["l_hand"], INDEX["r_hand"]]]
    knees = p[:, [INDEX["l_calf"], INDEX["r_calf"]]]
    assert hands[..., 2].min() > knees[..., 2].max() + 0.08
    assert hands[..., 2].max() - hands[..., 2].min() < 0.25
    assert (hands[..., 0] > p[:, INDEX["chest"], None, 0] + 0.15).all()
    assert np.ptp(hands, axis=0).max() > 0.02  # something is done
    for s in ("l_", "r_"):
        thigh, calf = (clip.rotations[:, INDEX[s + part]] for part in ("thigh", "calf"))
        assert 0.9 < bend_angle(thigh, calf).min() < 2.2


def test_other_tasks_are_refused_with_the_valid_ones():
    with pytest.raises(InputError, match=r"'sleep'.*typing, mouse, writing"):
        make_motion("desk", 4.0, np.random.default_rng(1), tasks=("sleep",))


def test_the_desk_lies_between_hands_and_knees(stand_in):
    motion = MotionTable(name="desk")
    clip = make_motion("desk", 6.0, np.random.default_rng(1))
    times = np.arange(150) / 30
    bodies = sample_reference(stand_in, retarget(clip, stand_in), times)
    performance = Performance(stand_in, motion, 1, times, bodies)
    (extra,) = make_prop(ThingTable(kind="desk"), performance, np.random.default_rng(0))
    top = next(mesh for mesh in extra.actor.meshes if mesh.name == "top")
    low, high = top.vertices.min(0), top.vertices.max(0)
    palms = np.stack([performance.held(k, performance.palms[k].centre) for k in (0, 1)])
    assert high[2] < palms[..., 2].min() < high[2] + 0.05
    assert bodies[:, INDEX["l_calf"], 2, 3].max() < low[2]
    over = (palms[..., :2] > low[:2]).all(-1) & (palms[..., :2] < high[:2]).all(-1)
    assert over.mean() > 0.95
    assert bodies[:, INDEX["chest"], 0, 3].max() < low[0]
