from pathlib import Path

import numpy as np
import pytest

from egocap.errors import InputError
from egocap.geometry import LEFT, UP, axis_angle
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.human.body.soles import sole_points
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.figure import joint_positions
from egocap_sim.motion.retarget.retarget import canonical_offsets, retarget

FPS = 60.0
MOTIONS = Path(__file__).parents[5] / "shared" / "motions"


def clip(rotations=None, pelvis=None, seconds=1.0, fps=FPS, **changes) -> Clip:
    """A clip of the standard figure; standing still unless told otherwise."""
    n = round(seconds * fps) + 1
    R = np.tile(np.eye(3), (n, len(BODIES), 1, 1)) if rotations is None else rotations
    p = np.tile(figure.REST[0], (len(R), 1)) if pelvis is None else pelvis
    fields = {"name": "test", "fps": fps, "positions": figure.positions(R, p), "rotations": R}
    return Clip(**{**fields, "canonical": True, **changes})


def pose(person, reference):
    return joint_positions(person.joints, reference.root, reference.rotations)


def direction(P, a, b):
    d = P[:, INDEX[b]] - P[:, INDEX[a]]
    return d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize("side", ["l", "r"])
def test_canonical_pose_hangs_the_arms_and_straightens_the_legs(stand_in, side):
    P = pose(stand_in, retarget(clip(), stand_in))
    for a, b in (("upperarm", "forearm"), ("forearm", "hand"), ("thigh", "calf"),
                 ("calf", "foot")):  # fmt: skip
        d = direction(P, f"{side}_{a}", f"{side}_{b}")
        np.testing.assert_allclose(d, np.tile(-UP, (len(d), 1)), atol=2e-3, err_msg=f"{a}")
    foot = direction(P, f"{side}_foot", f"{side}_toe")
    np.testing.assert_allclose(foot[:, 1], 0.0, atol=1e-3)  # turned-out feet point straight ahead


@pytest.mark.parametrize("side", ["l", "r"])
def test_elbow_hinges_where_the_person_has_it(stand_in, side):
    """A forearm lifted to the front in the clip lies in front, and the hinge axis is the arm's."""
    R = np.tile(np.eye(3), (61, 21, 1, 1))
    lifted = axis_angle(-LEFT, np.pi / 2)
    for part in ("forearm", "hand"):
        R[:, INDEX[f"{side}_{part}"]] = lifted
    P = pose(stand_in, retarget(clip(R), stand_in))
    d = direction(P, f"{side}_forearm", f"{side}_hand")
    np.testing.assert_allclose(d, np.tile([1.0, 0.0, 0.0], (len(d), 1)), atol=1e-6)
    offset = canonical_offsets(stand_in)
    j = stand_in.joints
    hinge = np.cross(j[INDEX[f"{side}_forearm"]] - j[INDEX[f"{side}_upperarm"]],
                     j[INDEX[f"{side}_hand"]] - j[INDEX[f"{side}_forearm"]])  # fmt: skip
    turned = offset[INDEX[f"{side}_forearm"]] @ (hinge / np.linalg.norm(hinge))
    np.testing.assert_allclose(turned, -LEFT, atol=1e-9)


def test_bone_directions_of_any_pose_carry_over(stand_in):
    rng = np.random.default_rng(3)
    arms = [INDEX[f"{s}_{p}"] for s in "lr" for p in ("upperarm", "forearm")]
    R = np.tile(np.eye(3), (61, 21, 1, 1))
    for b in arms:
        axis = rng.normal(size=3)
        R[:, b] = axis_angle(axis / np.linalg.norm(axis), rng.uniform(0, 2))
    P = pose(stand_in, retarget(clip(R), stand_in, from_origin=False))
    for s in "lr":
        np.testing.assert_allclose(direction(P, f"{s}_upperarm", f"{s}_forearm")[30],
                                   R[30, INDEX[f"{s}_upperarm"]] @ -UP, atol=1e-6)  # fmt: skip


def test_soles_come_to_the_floor_whatever_the_clip_floor(stand_in):
    for height in (-0.3, 0.0, 0.2):
        c = clip(pelvis=np.tile(figure.REST[0] + [0, 0, height], (61, 1)))
        r = retarget(c, stand_in)
        points = sole_points(stand_in, pose(stand_in, r), r.rotations)
        np.testing.assert_allclose(points[..., 2].min((1, 2)), 0.0, atol=2e-3)
        assert r.planted.all()


def test_stride_scales_with_the_legs(stand_in):
    flying = np.tile(figure.REST[0], (61, 1))
    flying[:, 0] += np.linspace(0, 3.0, 61)  # faster than a foot that stands
    scale = 1.1
    c = clip(pelvis=flying)
    taller = Clip(c.name, c.fps, c.positions * scale, c.rotations, canonical=True)
    legs = [sum(np.linalg.norm(j[INDEX[f"l_{b}"]] - j[INDEX[f"l_{a}"]])
                for a, b in (("thigh", "calf"), ("calf", "foot")))
            for j in (stand_in.joints, figure.REST)]  # fmt: skip
    for source in (c, taller):
        r = retarget(source, stand_in)
        travelled = r.root[-5, 0] - r.root[4, 0]
        assert travelled == pytest.approx(3.0 * legs[0] / legs[1] * 42 / 50, rel=0.01)


def test_sliding_feet_are_held(stand_in):
    slow = np.tile(figure.REST[0], (121, 1))
    slow[:, 1] += 0.03 * np.sin(np.linspace(0, 2 * np.pi, 121))
    r = retarget(clip(pelvis=slow, seconds=2.0), stand_in)
    points = sole_points(stand_in, pose(stand_in, r), r.rotations)
    inner = slice(5, -5)
    assert np.ptp(r.root[inner, 1]) > 0.04
    assert np.ptp(points[inner], axis=0).max() < 0.004


def test_a_jump_is_not_pulled_to_the_floor(stand_in):
    t = np.arange(121) / FPS
    height = np.where((t > 0.6) & (t < 1.2), 4.905 * (t - 0.6) * (1.2 - t), 0.0)
    pelvis = figure.REST[0] + height[:, None] * UP
    r = retarget(clip(pelvis=pelvis, seconds=2.0), stand_in)
    points = sole_points(stand_in, pose(stand_in, r), r.rotations)
    assert points[45, ..., 2].min() > 0.8 * height.max()
    assert not (r.planted | r.touching)[40:50].any()
    assert r.planted[[10, -10]].all()


def test_rough_ground_is_levelled(stand_in):
    """A step of 0.25 m, stood on for a second, becomes floor."""
    rise = 0.25 / (1 + np.exp(-(np.arange(181) - 90) / 4.0))
    r = retarget(clip(pelvis=figure.REST[0] + rise[:, None] * UP, seconds=3.0), stand_in)
    points = sole_points(stand_in, pose(stand_in, r), r.rotations)
    np.testing.assert_allclose(points[[10, -10]][..., 2].min((1, 2)), 0.0, atol=5e-3)


def test_starts_at_the_origin_facing_ahead_or_where_the_clip_does(stand_in):
    R = np.tile(axis_angle(UP, 2.0), (61, 21, 1, 1))
    c = clip(R, np.tile(figure.REST[0] + [4.0, -3.0, 0.0], (61, 1)))
    r = retarget(c, stand_in)
    np.testing.assert_allclose(r.root[0, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(r.rotations[0, 0], np.eye(3), atol=1e-9)
    kept = retarget(c, stand_in, from_origin=False)
    np.testing.assert_allclose(kept.rotations[0, 0], axis_angle(UP, 2.0), atol=1e-9)
    assert kept.root[0, 0] > 3.0


def test_resampling_keeps_a_steady_turn_steady(stand_in):
    R = np.tile(np.eye(3), (241, 21, 1, 1))
    R[:, INDEX["head"]] = axis_angle(UP, np.linspace(0, 2.0, 241))
    r = retarget(clip(R, seconds=2.0, fps=120.0), stand_in, fps=50)
    assert len(r.root) == 101 and r.duration_s == pytest.approx(2.0)
    angle = np.arctan2(r.rotations[:, INDEX["head"], 1, 0], r.rotations[:, INDEX["head"], 0, 0])
    np.testing.assert_allclose(np.diff(angle), 0.02, atol=1e-4)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"canonical": False}, "canonical"),
        ({"rotations": np.full((61, 21, 3, 3), np.nan)}, "not finite"),
        ({"positions": np.zeros((61, 21, 3))}, "legs of 0.000 m"),
        ({"fps": 0.0}, "at 0 per second"),
    ],
)
def test_bad_clips_are_refused(stand_in, changes, says):
    good = clip()
    fields = {name: getattr(good, name) for name in Clip.__dataclass_fields__}
    with pytest.raises(InputError, match=says):
        retarget(Clip(**{**fields, **changes}), stand_in)


def test_short_clips_and_odd_rates_are_refused(stand_in):
    with pytest.raises(InputError, match="at least"):
        retarget(clip(seconds=0.1), stand_in)
    with pytest.raises(InputError, match="10 to 500"):
        retarget(clip(), stand_in, fps=2)


@pytest.mark.skipif(not MOTIONS.is_dir(), reason="needs ../shared/motions")
def test_recorded_walk_stands_on_the_floor(stand_in):
    from egocap_sim.motion.clips.load import load_clip

    r = retarget(load_clip(MOTIONS / "npz" / "walking_1.npz"), stand_in)
    lowest = sole_points(stand_in, pose(stand_in, r), r.rotations)[..., 2].min((1, 2))
    assert np.abs(lowest).max() < 0.01
    assert r.planted.any(1).mean() > 0.9
    knees = [INDEX["l_calf"], INDEX["r_calf"]]
    ankles, hips = [INDEX["l_foot"], INDEX["r_foot"]], [INDEX["l_thigh"], INDEX["r_thigh"]]
    P = pose(stand_in, r)
    ahead = P[:, knees] - (P[:, hips] + P[:, ankles]) / 2
    assert np.percentile(ahead[..., 0], 5) > -0.01  # knees never bend backwards
