from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from egocap.errors import FileError, InputError
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.motion import load_clip
from egocap_sim.motion.clips.load import UNITS

SAMPLE = ("bvh/002_01.bvh", "bvh/005_01.bvh", "bvh/006_08.bvh", "npz/jumping_2.npz",
          "npz/running_1.npz", "npz/soccer_1.npz")  # fmt: skip


@pytest.mark.parametrize("unit", UNITS)
def test_unit_is_recognised(unit: str, active, bvh_file, rig) -> None:
    clip = load_clip(bvh_file(active, rig(unit=UNITS[unit])))
    np.testing.assert_allclose(np.ptp(clip.positions, 0), np.ptp(active.positions, 0), atol=5e-3)


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("six", [False, True])
def test_up_axis_is_recognised(up: str, six: bool, active, bvh_file, rig) -> None:
    frames = Rotation.random(21, random_state=5).as_matrix()
    clip = load_clip(bvh_file(active, rig(up=up, six=six, frames=frames, order="YXZ")))
    shift = clip.positions[0, 0] - active.positions[0, 0]
    assert abs(shift[2]) < 0.02
    np.testing.assert_allclose(clip.positions - shift, active.positions, atol=5e-3)


def test_given_up_axis_and_unit_win(active, bvh_file, rig) -> None:
    path = bvh_file(active, rig(unit=0.01))
    big = load_clip(path, unit=0.02, up="y")
    assert np.ptp(big.positions[0, :, 2]) == pytest.approx(
        2 * np.ptp(active.positions[0, :, 2]), rel=0.02
    )


@pytest.mark.parametrize("fps", [25.0, 120.0])
def test_any_frame_rate(fps: float, bvh_file) -> None:
    from egocap_sim.motion import make_motion

    clip = make_motion("squat", 4.0, np.random.default_rng(0), fps)
    found = load_clip(bvh_file(clip))
    assert found.fps == pytest.approx(fps, rel=1e-4) and len(found.positions) == len(clip.positions)


@pytest.mark.parametrize(
    "options", [{"up": "w"}, {"unit": "parsec"}, {"unit": -1.0}, {"unit": True}]
)
def test_impossible_options(options: dict, active, bvh_file) -> None:
    with pytest.raises(InputError, match="valid"):
        load_clip(bvh_file(active), **options)


def test_no_unit_fits(active, bvh_file, rig) -> None:
    with pytest.raises(FileError, match="unit"):
        load_clip(bvh_file(active, rig(unit=7.0)))


@pytest.mark.parametrize("scale", [0.0, 100.0])
def test_npz_that_is_not_in_metres(scale: float, active, tmp_path) -> None:
    quat = Rotation.from_matrix(active.rotations.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    np.savez(tmp_path / "a.npz", joints=np.array(BODIES), pos=active.positions * scale,
             quat=quat.reshape(-1, len(BODIES), 4), fps=active.fps)  # fmt: skip
    with pytest.raises(FileError, match=r"a\.npz: .*legs are .*metres"):
        load_clip(tmp_path / "a.npz")


def test_a_given_unit_that_makes_a_giant(active, bvh_file, rig) -> None:
    with pytest.raises(FileError, match=r"legs are .*unit=m"):
        load_clip(bvh_file(active, rig(unit=0.01)), unit="m")


def test_unknown_kind(tmp_path) -> None:
    with pytest.raises(FileError, match=r"valid: \.bvh"):
        load_clip(tmp_path / "a.fbx")


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_files_give_a_finite_clip_or_an_error(
    data: st.DataObject, active, bvh_file
) -> None:
    path = bvh_file(dataclasses.replace(
        active, positions=active.positions[:4], rotations=active.rotations[:4]))  # fmt: skip
    lines = path.read_text().splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(lines) - 1))
        words = lines[at].split() or [""]
        word = data.draw(st.integers(0, len(words) - 1))
        words[word] = data.draw(st.sampled_from(["", "0", "-9e6", "l_hand", "}", "1e-300", "180"]))
        lines[at] = " ".join(words)
    path.write_text("\n".join(lines))
    try:
        clip = load_clip(path)
    except FileError:
        return
    assert np.isfinite(clip.positions).all() and np.isfinite(clip.rotations).all()


def test_a_bone_without_length_is_an_error(active, bvh_file):
    path = bvh_file(active)
    text = path.read_text()
    at = text.index("OFFSET", text.index("JOINT l_calf"))
    path.write_text(text[:at] + "OFFSET 0 0 0" + text[text.index("\n", at) :])
    with pytest.raises(FileError, match=r"l_thigh.* a bone there has no length"):
        load_clip(path)


@pytest.mark.parametrize("name", SAMPLE)
def test_recorded_motions_are_human(name: str, shared_motions) -> None:
    clip = load_clip(shared_motions / name)
    R, p = clip.rotations, clip.positions
    assert clip.canonical and np.isfinite(R).all() and np.isfinite(p).all()
    np.testing.assert_allclose(
        R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-6
    )
    assert 1.2 < np.median(p[:, INDEX["head"], 2]) < 1.75
    for side in ("l_", "r_"):
        knee = np.swapaxes(R[:, INDEX[side + "thigh"]], -1, -2) @ R[:, INDEX[side + "calf"]]
        flexion = np.degrees(np.arctan2(knee[:, 0, 2], knee[:, 2, 2]))
        assert flexion.max() > 25 and np.quantile(flexion, 0.02) > -12, side
        elbow = np.swapaxes(R[:, INDEX[side + "upperarm"]], -1, -2) @ R[:, INDEX[side + "forearm"]]
        assert np.median(np.arctan2(elbow[:, 0, 2], elbow[:, 2, 2])) < 0, side
        # The bones point where the joints are.
        for upper, lower in (("thigh", "calf"), ("calf", "foot"), ("upperarm", "forearm")):
            bone = p[:, INDEX[side + lower]] - p[:, INDEX[side + upper]]
            bone /= np.linalg.norm(bone, axis=1, keepdims=True)
            assert (-(bone * R[:, INDEX[side + upper], :, 2]).sum(1)).min() > 0.98
    nose = R[:, INDEX["head"], 2, 0]
    assert abs(np.degrees(np.arcsin(np.median(nose)))) < 15
    pelvis = R[:, INDEX["pelvis"]]
    assert np.median(pelvis[:, 2, 2]) > 0.95
    assert len(BODIES) == R.shape[1]
