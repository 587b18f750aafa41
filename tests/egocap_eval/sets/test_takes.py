"""Takes are recognised across skeletons, trimming and mirroring, and told apart otherwise."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap_eval.sets.takes import (
    SAME,
    correlation,
    limb_directions,
    link_clips,
    matching,
    mirrored,
)
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.motion.generators.registry import make_motion


def directions(name, seed, seconds=8.0):
    clip = make_motion(name, seconds, np.random.default_rng(seed))
    return limb_directions(clip.positions[:: round(clip.fps / 15)])


@pytest.mark.parametrize("mirror", [False, True])
def test_a_trimmed_take_on_another_skeleton_is_found(mirror):
    take = directions("gestures", 1)
    tilt = Rotation.from_rotvec(np.random.default_rng(0).normal(0, 0.15, (8, 3))).as_matrix()
    other = np.einsum("bij,tbj->tbi", tilt, take[17:95])
    other = mirrored(other) if mirror else other
    clips = {"a": ("training", take), "b": ("test", other), "c": ("training", take)}
    assert [(m.first, m.second, m.mirrored) for m in matching(clips)] == [
        ("a", "b", mirror), ("b", "c", mirror),
    ]  # fmt: skip


def test_other_takes_are_not():
    for name in ("gestures", "sequence", "dribble"):
        assert correlation(directions(name, 1), directions(name, 2)) < SAME - 0.05
    assert correlation(directions("walk", 1)[:15], directions("walk", 1)) == 0.0  # too short


def test_directions_do_not_depend_on_place_heading_or_size():
    clip = make_motion("walk", 2.0, np.random.default_rng(0))
    turn = Rotation.from_euler("z", 1.0).as_matrix()
    moved = 1.3 * clip.positions @ turn.T + np.array([1.0, 2.0, 0.0])
    assert np.allclose(limb_directions(moved), limb_directions(clip.positions))
    assert clip.positions.shape[1] == len(BODIES)
    standing = limb_directions(clip.positions)[0]
    assert standing[2, 2] < -0.8 and standing[6, 2] < -0.8  # thighs point down
    assert INDEX["l_thigh"] != INDEX["r_thigh"]


def test_links_keep_the_places_of_clips(tmp_path):
    clip = tmp_path / "clips" / "bvh" / "007_05.bvh"
    clip.parent.mkdir(parents=True)
    clip.write_text("x")
    for _ in range(2):  # again without an error
        link_clips([clip], tmp_path / "clips", tmp_path / "links")
    assert (tmp_path / "links/bvh/007_05.bvh").resolve() == clip
