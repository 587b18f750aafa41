"""A track written as BVH and read back by the simulator's own reader, and by bvhio where it is."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap.body.proportions import Proportions
from egocap.body.skeleton import LIMITS, forward
from egocap.data.bvh import write_bvh
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.geometry import axis_angle, rigid, transform
from egocap_sim.motion.clips.bvh import pose, read_bvh

_BACK = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # x left, y up, z forward -> ours
NAMES = {
    "neck": "Neck", "left_shoulder": "LeftArm", "left_elbow": "LeftForeArm",
    "left_wrist": "LeftHand", "right_shoulder": "RightArm", "right_elbow": "RightForeArm",
    "right_wrist": "RightHand", "left_hip": "LeftUpLeg", "left_knee": "LeftLeg",
    "left_ankle": "LeftFoot", "right_hip": "RightUpLeg", "right_knee": "RightLeg",
    "right_ankle": "RightFoot",
}  # fmt: skip


def made(frames=12, seed=0, world=False):
    rng = np.random.default_rng(seed)
    angles = rng.uniform(LIMITS[:, 0], LIMITS[:, 1], (frames, 37))
    person = Proportions.from_lengths(1.8)
    joints = forward(person, angles)
    track = Track(
        np.arange(frames) / 25, angles, joints, np.zeros(frames), np.ones(frames, bool),
        np.zeros(frames), 0.001, {}, offsets=np.array(person.offsets),
    )  # fmt: skip
    if not world:
        return track
    T = rigid(axis_angle(np.array([0, 0.6, 0.8]), rng.normal(size=frames)),
              rng.normal(size=(frames, 3)))  # fmt: skip
    return replace(track, T_world_head=T, joints_world=transform(T, joints))


def read_points(path):
    bvh = read_bvh(path)
    R, position = pose(tuple(j.parent for j in bvh.joints), *bvh.local())
    found = {joint.name: position[:, i] @ _BACK.T for i, joint in enumerate(bvh.joints)}
    for i, joint in enumerate(bvh.joints):
        if joint.end_site is not None:
            end = position[:, i] + R[:, i] @ np.array(joint.end_site)
            found[joint.name + " end"] = end @ _BACK.T
    return bvh, found


@pytest.mark.parametrize("world", [False, True])
def test_the_reader_finds_every_joint_where_the_track_has_it(tmp_path, world):
    track = made(world=world)
    write_bvh(tmp_path / "t.bvh", track)
    bvh, found = read_points(tmp_path / "t.bvh")
    assert bvh.fps == pytest.approx(25)
    joints = track.joints_world if world else track.joints_head
    names = NAMES | {"head": "Head end", "left_hand": "LeftHand end", "right_hand": "RightHand end",
                     "left_foot": "LeftFoot end", "right_foot": "RightFoot end"}  # fmt: skip
    assert set(names) == set(LABEL_INDEX)
    for label, name in names.items():
        assert np.allclose(found[name], joints[:, LABEL_INDEX[label]], atol=2e-5), label


def test_outside_reader_agrees(tmp_path):
    bvhio = pytest.importorskip("bvhio")
    track = made(frames=3)
    write_bvh(tmp_path / "t.bvh", track)
    root = bvhio.readAsHierarchy(str(tmp_path / "t.bvh"))
    for frame in range(3):
        root.loadPose(frame)
        for label, name in NAMES.items():
            joint = next(j for j, _, _ in root.layout() if j.Name == name)
            x, y, z = joint.PositionWorld
            assert np.allclose([z, x, y], track.joints_head[frame, LABEL_INDEX[label]], atol=1e-4)


def test_what_cannot_be_written_is_named(tmp_path):
    track = made()
    with pytest.raises(InputError, match="skeleton"):
        write_bvh(tmp_path / "t.bvh", replace(track, offsets=None))
    uneven = track.times + np.linspace(0, 1, 12) ** 2
    with pytest.raises(InputError, match="evenly"):
        write_bvh(tmp_path / "t.bvh", replace(track, times=uneven))
    for step in (1e-9, 1e9, 1e13):
        with pytest.raises(InputError, match="s apart"):
            write_bvh(tmp_path / "t.bvh", replace(track, times=step * np.arange(12)))
    assert not list(tmp_path.iterdir())
