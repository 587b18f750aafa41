"""Calibration files: what they mean, and that no content gives anything but our own errors."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from egocap.cameras.camera import Camera
from egocap.cameras.camera_files import camera_from_dict, load_camera, parse_ocam_text
from egocap.errors import EgocapError, FileError

TEXT = """\
#polynomial coefficients for the DIRECT mapping function
5 -283.0247 0.0 1.130153e-03 -1.870746e-07 1.54814e-09

#polynomial coefficients for the inverse mapping function
3 455.2 304.1 30.1

#center: "row" and "column", starting from 0 (C convention)
380.5 430.25

#affine parameters "c", "d", "e"
0.999 0.002 -0.003

#image size: "height" and "width"
800 848
"""
OCAM_JSON = {
    "size": [848, 800],
    "image_center": [430.25, 380.5],
    "polynomialC2W": [-283.0247, 0.0, 1.130153e-3, -1.870746e-7, 1.54814e-9],
    "polynomialW2C": [455.2, 304.1],
    "affine": [0.999, 0.002, -0.003],
    "imageCircleRadius": 390,
    "name": "anything",
}
OWN = {"model": "equidistant", "width": 640, "height": 512, "fov": 180.0}


def test_text_and_json_describe_the_same_camera(tmp_path: Path) -> None:
    (tmp_path / "calib_results.txt").write_text(TEXT)
    (tmp_path / "camera.json").write_text(json.dumps(OCAM_JSON))
    text, data = load_camera(tmp_path / "calib_results.txt"), load_camera(tmp_path / "camera.json")
    assert (text.width, text.height, text.centre) == (848, 800, (430.25, 380.5))
    assert text.affine == data.affine == ((1.0, -0.003), (0.002, 0.999))
    pixels = np.random.default_rng(0).uniform(200, 600, (50, 2))
    np.testing.assert_allclose(text.ray(pixels)[0], data.ray(pixels)[0], atol=1e-7)
    z = -np.polynomial.polynomial.polyval(390.0, OCAM_JSON["polynomialC2W"])
    assert data.max_angle == pytest.approx(math.atan2(390.0, z))
    assert text.max_angle > data.max_angle  # without a circle the whole image is seen


def test_the_text_is_ocamcalibs_cam2world() -> None:
    camera = parse_ocam_text(TEXT, "calib_results.txt")
    row, column = 500.0, 300.0
    x, y = np.linalg.solve([[0.999, 0.002], [-0.003, 1.0]], [row - 380.5, column - 430.25])
    z = np.polynomial.polynomial.polyval(math.hypot(x, y), OCAM_JSON["polynomialC2W"])
    expected = np.array([y, x, -z]) / math.sqrt(x * x + y * y + z * z)
    np.testing.assert_allclose(camera.ray(np.array([column, row]))[0], expected, atol=1e-7)


def test_an_intrinsic_matrix_gives_the_centre() -> None:
    data = {k: v for k, v in OCAM_JSON.items() if k != "image_center"}
    data["intrinsic"] = [[500, 0, 430.25, 0], [0, 500, 380.5, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    assert camera_from_dict(data) == camera_from_dict(OCAM_JSON)


def test_people_give_a_field_of_view() -> None:
    camera = camera_from_dict(OWN)
    assert camera.centre == (319.5, 255.5) and camera.max_angle == math.pi / 2
    pixels, valid = camera.project(np.array([[1.0, 0, 0], [-1.0, 0, 0]]))
    np.testing.assert_allclose(pixels, [[639.5, 255.5], [-0.5, 255.5]], atol=1e-9)
    assert valid.all()
    assert camera_from_dict(OWN | {"focal": 100}).affine == ((100.0, 0.0), (0.0, 100.0))
    kb = camera_from_dict(
        {"model": "kannala_brandt", "width": 640, "height": 512, "focal": [300, 310.0],
         "parameters": [0.01, 0.0, 0.0, 0.0]}
    )  # fmt: skip
    assert kb.affine == ((300.0, 0.0), (0.0, 310.0))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"fov": 0}, "fov"), ({"fov": 361}, "fov"), ({"fov": math.nan}, "fov"),
        ({"fov": "wide"}, "fov"), ({"fov": True}, "fov"), ({"width": -640}, "width"),
        ({"height": 0}, "height"), ({"width": 640.5}, "width"), ({"width": 10**9}, "width"),
        ({"centre": [1.0]}, "centre"), ({"centre": [math.inf, 0]}, "centre"),
        ({"model": "pinhole"}, "model"), ({"colour": 1}, "colour"), ({"focal": 0}, "focal"),
        ({"focal": [100, -1]}, "focal"), ({"focal": 1, "affine": [[1, 0], [0, 1]]}, "affine"),
        ({"affine": [[0, 0], [0, 0]]}, "affine"), ({"max_angle": 1}, "max_angle"),
        ({"model": "ocam"}, "polynomial"), ({"parameters": [1, 2, 3]}, "parameters"),
    ],
)  # fmt: skip
def test_wrong_values_name_file_and_key(change, key) -> None:
    with pytest.raises(FileError) as caught:
        camera_from_dict(OWN | change, "cam.json")
    assert str(caught.value).startswith("cam.json") and key in str(caught.value)


def test_an_unknown_key_lists_the_known_ones() -> None:
    with pytest.raises(FileError, match=r"key 'fovv': unknown key .*valid: .*fov, .*width"):
        camera_from_dict(OWN | {"fovv": 1}, "cam.json")
    misspelt = {"widht" if key == "width" else key: value for key, value in OWN.items()}
    with pytest.raises(FileError, match=r"key 'widht': unknown key .*1 more error"):
        camera_from_dict(misspelt, "cam.json")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("5 -283", "6 -283", "line 2.*announces 6"), ("800 848", "800", "line 14.*size"),
        ("800 848", "0 848", "line 14.*image size"), ("380.5 430.25", "380.5 x", "line 8"),
        ("380.5", "nan", "line 8.*finite"), ("800 848\n", "", "4 lines of numbers"),
        ("-283.0247", "283.0247", "not negative"),
    ],
)  # fmt: skip
def test_damaged_text_names_the_line(old, new, message) -> None:
    with pytest.raises(FileError, match=message):
        parse_ocam_text(TEXT.replace(old, new), "calib_results.txt")


def test_unreadable_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "half.json").write_text('{"model": ')
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "list.json").write_text("[1, 2]")
    for name in ("none.json", "half.json", "binary.txt", "list.json"):
        with pytest.raises(FileError, match=name):
            load_camera(tmp_path / name)
    with pytest.raises(FileError):
        load_camera(tmp_path)


numbers = st.one_of(
    st.floats(), st.integers(), st.sampled_from([0, 1, -300.0, 640, 3.2, 180, 1e308, 5e-324])
)
values = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, st.text(max_size=5)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=5), st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
    max_leaves=8,
)
OWN_KEYS = (
    "model",
    "width",
    "height",
    "centre",
    "focal",
    "affine",
    "fov",
    "max_angle",
    "parameters",
)


def only_our_errors(data: object) -> None:
    try:
        camera = camera_from_dict(data, "fuzz.json")
    except EgocapError as error:
        assert "fuzz.json" in str(error)
    else:
        assert isinstance(camera, Camera) and 0 < camera.max_angle <= math.pi


@settings(deadline=None, max_examples=150)
@given(
    base=st.sampled_from([OWN, OWN | {"model": "kannala_brandt", "focal": 300.0}, OCAM_JSON]),
    change=st.dictionaries(st.sampled_from([*OWN_KEYS, *OCAM_JSON]), values, max_size=3),
)
@example(base=OWN, change={"fov": 5e-324})
def test_fuzzed_cameras_give_a_camera_or_our_error(base, change) -> None:
    only_our_errors(base | change)


@settings(deadline=None, max_examples=60)
@given(values)
def test_anything_at_all_gives_our_error(data) -> None:
    only_our_errors(data)


@settings(deadline=None, max_examples=60)
@given(st.lists(numbers, min_size=1, max_size=6), st.floats(1e-3, 1e9))
def test_fuzzed_polynomials_give_a_camera_or_our_error(polynomial, circle) -> None:
    only_our_errors(OCAM_JSON | {"polynomialC2W": polynomial, "imageCircleRadius": circle})
    only_our_errors(
        OWN | {"model": "kannala_brandt", "focal": 300.0, "parameters": (polynomial * 4)[:4]}
    )


@settings(deadline=None, max_examples=80)
@given(st.text(alphabet="0123456789.-+e #\nnaif", max_size=200))
def test_fuzzed_text_gives_our_error(text) -> None:
    with pytest.raises(FileError):
        parse_ocam_text(text, "calib_results.txt")
