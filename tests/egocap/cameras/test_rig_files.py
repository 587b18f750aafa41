"""Rig files as people write them."""

import copy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from egocap.cameras.rig import Rig, camera_rotation
from egocap.cameras.rig_files import load_rig, parse_rig
from egocap.errors import EgocapError, FileError

LENS = {"model": "equidistant", "width": 640, "height": 512, "fov": 180.0}
STEREO = {
    "name": "s", "lens": LENS,
    "stereo": {"baseline": 0.2, "forward": 0.2, "up": 0.1, "pitch": 60.0},
}  # fmt: skip
FREE = {
    "name": "f", "lens": LENS,
    "cameras": [
        {"name": "left", "position": [0.2, 0.1, 0.1], "pitch": 60.0},
        {"name": "right", "position": [0.2, -0.1, 0.1], "pitch": 60.0},
    ],
}  # fmt: skip


def test_angles_turn_the_way_they_say() -> None:
    np.testing.assert_allclose(camera_rotation(0), [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-15)
    np.testing.assert_allclose(camera_rotation(90)[:, 2], [0, 0, -1], atol=1e-15)  # down
    np.testing.assert_allclose(camera_rotation(90)[:, 1], [-1, 0, 0], atol=1e-15)  # up: forward
    np.testing.assert_allclose(camera_rotation(0, 90)[:, 2], [0, 1, 0], atol=1e-15)  # left
    np.testing.assert_allclose(
        camera_rotation(0, 0, 90)[:, 0], [0, 0, -1], atol=1e-15
    )  # right: down
    turned = camera_rotation(33.0, -20.0, 5.0)
    expected = Rotation.from_euler("ZYX", [-20.0, 33.0, 5.0], degrees=True).as_matrix()
    np.testing.assert_allclose(turned, expected @ camera_rotation(0), atol=1e-12)


def test_the_shorthand_is_two_cameras_written_out() -> None:
    short, long = parse_rig(STEREO, "a.toml"), parse_rig(FREE, "b.toml")
    assert short.mounts == long.mounts
    toed = copy.deepcopy(STEREO)
    toed["stereo"]["toe_out"] = 10.0
    left, right = parse_rig(toed, "a.toml").T_head_camera[:, :3, 2]
    assert left[1] > 0 > right[1] and left[1] == pytest.approx(-right[1])


def test_a_rotation_matrix_replaces_the_angles() -> None:
    data = copy.deepcopy(FREE)
    for camera in data["cameras"]:
        camera["rotation"] = camera_rotation(camera.pop("pitch")).round(6).tolist()
    written, angles = parse_rig(data, "a.toml"), parse_rig(FREE, "b.toml")
    np.testing.assert_allclose(written.T_head_camera, angles.T_head_camera, atol=1e-6)
    R = written.T_head_camera[0, :3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)  # rounded digits are repaired


def test_calibration_files_lie_beside_the_rig(tmp_path: Path) -> None:
    (tmp_path / "lenses").mkdir()
    (tmp_path / "lenses" / "left.txt").write_text(
        "3 -283.0 0 1.1e-3\n1 400\n255.5 319.5\n1 0 0\n512 640\n"
    )
    (tmp_path / "rig.toml").write_text(
        "name = 'own'\n"
        "[lens]\nmodel = 'equidistant'\nwidth = 640\nheight = 512\nfov = 180\n"
        "[[cameras]]\nname = 'left'\nposition = [0.2, 0.1, 0.1]\n"
        "calibration = 'lenses/left.txt'\n"
        "[[cameras]]\nname = 'right'\nposition = [0.2, -0.1, 0.1]\n"
    )
    left, right = load_rig(tmp_path / "rig.toml").cameras
    assert (left.model, right.model) == ("ocam", "equidistant")
    (tmp_path / "lenses" / "left.txt").unlink()
    with pytest.raises(FileError, match=r"left\.txt: no such file"):
        load_rig(tmp_path / "rig.toml")


@pytest.mark.parametrize(
    ("path", "value", "key"),
    [
        (("lens", "fov"), 0, "lens.fov"), (("lens", "fov"), 301.0, "lens.fov"),
        (("lens", "fov"), -10, "lens.fov"), (("lens", "width"), 0, "lens.width"),
        (("stereo", "baseline"), -0.1, "stereo.baseline"), (("stereo", "baseline"), 0, "baseline"),
        (("stereo", "baseline"), 2.5, "stereo.baseline"), (("stereo", "pitch"), "down", "pitch"),
        (("stereo", "forward"), float("nan"), "stereo.forward"), (("stereo", "tilt"), 1, "tilt"),
        (("frame_rate",), 0, "frame_rate"), (("colour",), 1, "colour"), (("lens",), None, "lens"),
        (("cameras",), FREE["cameras"], "either"), (("name",), "", "name"),
    ],
)  # fmt: skip
def test_impossible_values_name_file_and_key(path, value, key) -> None:
    data = copy.deepcopy(STEREO)
    inner = data
    for step in path[:-1]:
        inner = inner[step]
    inner[path[-1]] = value
    with pytest.raises(FileError) as caught:
        parse_rig(data, "rig.toml")
    assert str(caught.value).startswith("rig.toml") and key in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rotation": np.diag([1.0, 1, 2]).tolist(), "pitch": None}, "orthonormal"),
        ({"rotation": np.diag([1.0, 1, -1]).tolist(), "pitch": None}, "right-handed"),
        ({"rotation": np.eye(3).tolist()}, "not both"),
        ({"position": [9.0, 0, 0]}, "more than 2 m"),
        ({"position": [1.0, 0]}, r"cameras\.1\.position"),
        ({"lens": {**LENS, "fov": 350}}, r"cameras\.1\.lens\.fov"),
        ({"lens": {**LENS, "fovv": 1}}, r"cameras\.1\.lens\.fovv.*valid: .*fov"),
        ({"name": "left"}, "own name"),
        ({"pich": 1}, r"cameras\.1\.pich': unknown key .*valid: .*pitch"),
    ],
)
def test_a_wrong_camera_is_named(change, message) -> None:
    data = copy.deepcopy(FREE)
    camera = data["cameras"][1] | change
    data["cameras"][1] = {k: v for k, v in camera.items() if v is not None}
    with pytest.raises(FileError, match=message):
        parse_rig(data, "rig.toml")


def test_broken_toml_says_where(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text("name = \n")
    with pytest.raises(FileError, match=r"rig\.toml: not TOML: .*line 1"):
        load_rig(tmp_path / "rig.toml")


numbers = st.one_of(st.floats(), st.integers(-400, 400), st.booleans())
values = st.recursive(
    st.one_of(st.none(), numbers, st.text(max_size=4)),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=6,
)
keys = st.sampled_from(
    ["name", "lens", "stereo", "cameras", "frame_rate", "baseline", "forward", "up", "pitch",
     "toe_out", "position", "rotation", "calibration", "fov", "width", "mounts", "schema"]
)  # fmt: skip


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_fuzzed_rigs_give_a_rig_or_our_error(data) -> None:
    rig = copy.deepcopy(data.draw(st.sampled_from([STEREO, FREE])))
    tables = [rig, *(t for t in (rig.get("stereo"), *rig.get("cameras", ())) if t)]
    for _ in range(data.draw(st.integers(1, 3))):
        data.draw(st.sampled_from(tables))[data.draw(keys)] = data.draw(values)
    try:
        assert isinstance(parse_rig(rig, "fuzz.toml"), Rig)
    except EgocapError as error:
        assert error.exit_code == 2


@settings(deadline=None, max_examples=60)
@given(values)
def test_anything_at_all_gives_our_error(data) -> None:
    with pytest.raises(FileError, match=r"fuzz\.json"):
        parse_rig(data, "fuzz.json")


def test_a_calibration_is_not_taken_for_a_rig() -> None:
    with pytest.raises(FileError, match=r"a\.json: holds one camera, not a rig .*calibration"):
        parse_rig(LENS, "a.json")
