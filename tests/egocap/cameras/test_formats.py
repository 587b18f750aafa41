"""Other programs' calibration files against OpenCV and closed forms; round trips; damaged files."""

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.cameras.camera import Camera
from egocap.cameras.camera_files import load_camera, read_cameras
from egocap.cameras.camera_set import CameraSet, SetCamera, mount_at
from egocap.cameras.formats import WRITERS, format_cameras
from egocap.cameras.lens_fit import GOOD_PX, exact
from egocap.cameras.rig import Mount, Rig
from egocap.cameras.rig_files import format_rig, load_rig
from egocap.errors import EgocapError, FileError
from egocap.geometry import inverse, rigid

K4 = (0.012, -0.009, 0.004, -0.0008)
KB = Camera("kannala_brandt", 1280, 1024, (630.2, 520.7), ((402.0, 0.0), (0.0, 401.0)), K4)
RADTAN = (-0.25, 0.06, 0.0003, -0.0004)


def rays(widest: float = 1.3, count: int = 400) -> np.ndarray:
    rng = np.random.default_rng(0)
    theta, turn = rng.uniform(0.01, widest, count), rng.uniform(0, 2 * np.pi, count)
    return np.stack([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)], -1)


def off(camera: Camera, points: np.ndarray, expected: np.ndarray) -> float:
    """Largest distance between a camera's pixels and the expected ones inside the image."""
    pixels, valid = camera.project(points)
    assert valid.sum() > 100
    return float(np.linalg.norm(pixels - expected, axis=1)[valid].max())


def no_pose() -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((3, 1)), np.zeros((3, 1))


def kalibr(folder: Path, **cam1: object) -> Path:
    first = {
        "camera_model": "pinhole", "intrinsics": [402.0, 401.0, 630.2, 520.7],
        "distortion_model": "equidistant", "distortion_coeffs": list(K4),
        "resolution": [1280, 1024], "rostopic": "/cam0/image_raw",
    }  # fmt: skip
    path = folder / "camchain.yaml"
    path.write_text(yaml.safe_dump({"cam0": first} | ({"cam1": first | cam1} if cam1 else {})))
    return path


def storage(path: Path, **values: object) -> Path:
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        file.write(name, np.array(value, float) if isinstance(value, list) else value)
    file.release()
    return path


def matrix(fx: float, fy: float, cx: float, cy: float) -> list[list[float]]:
    return [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]


def test_kalibr_equidistant_is_cv2_fisheye(tmp_path: Path) -> None:
    camera = load_camera(kalibr(tmp_path))
    K = np.array(matrix(402.0, 401.0, 630.2, 520.7))
    expected, _ = cv2.fisheye.projectPoints(rays()[:, None], *no_pose(), K, np.array(K4))
    assert off(camera, rays(), expected[:, 0]) < 1e-9


def test_the_chain_is_followed_from_camera_to_camera(tmp_path: Path) -> None:
    T_1_0 = inverse(mount_at((0.0, 0.35, 0.0), 12.0, 3.0, 90.0))
    cameras = read_cameras(kalibr(tmp_path, T_cn_cnm1=T_1_0.tolist())).cameras
    place = cameras[1].T_first_camera
    assert place is not None
    np.testing.assert_allclose(place, inverse(T_1_0), atol=1e-12)
    point = np.array([0.1, -0.2, 0.8, 1.0])
    np.testing.assert_allclose(inverse(place) @ point, T_1_0 @ point, atol=1e-12)


@pytest.mark.parametrize("xi", [0.8, 1.3])
def test_omnidirectional_cameras_are_cv2_omnidir(tmp_path: Path, xi: float) -> None:
    focal = 300.0 * (1 + xi)
    K, D = np.array(matrix(focal, focal, 630.2, 520.7)), np.array(RADTAN)
    points = rays(1.35)
    expected, _ = cv2.omnidir.projectPoints(points[:, None], *no_pose(), K, xi, D[None])
    omni = {"camera_model": "omni", "intrinsics": [xi, focal, focal, 630.2, 520.7],
            "distortion_model": "radtan", "distortion_coeffs": list(RADTAN)}  # fmt: skip
    chain = kalibr(tmp_path, **omni, T_cn_cnm1=np.eye(4).tolist())
    own = storage(tmp_path / "omni.xml", image_width=1280, image_height=1024, K=K.tolist(),
                  D=list(RADTAN), xi=[xi])  # fmt: skip
    for lens in (read_cameras(chain).cameras[1].lens, read_cameras(own).cameras[0].lens):
        assert off(lens.camera, points, expected[:, 0]) <= 1.01 * lens.max_px
        assert lens.rms_px < 0.5


def eucm(p: np.ndarray, a: float, b: float) -> np.ndarray:
    x, y, z = p.T  # Khomutenko et al. 2016, equation 10
    return p[:, :2] / (a * np.sqrt(b * (x**2 + y**2) + z**2) + (1 - a) * z)[:, None]


def ds(p: np.ndarray, xi: float, a: float) -> np.ndarray:
    x, y, z = p.T  # Usenko et al. 2018, equations 40 to 43
    d1 = np.sqrt(x**2 + y**2 + z**2)
    d2 = np.sqrt(x**2 + y**2 + (xi * d1 + z) ** 2)
    return p[:, :2] / (a * d2 + (1 - a) * (xi * d1 + z))[:, None]


@pytest.mark.parametrize(("model", "own"), [("eucm", (0.62, 1.1)), ("ds", (-0.2, 0.6))])
def test_eucm_and_double_sphere_are_fitted_within_the_stated_error(tmp_path, model, own) -> None:
    intrinsics = [*own, 340.0, 341.0, 630.2, 520.7]
    chain = kalibr(
        tmp_path, camera_model=model, distortion_model="none", distortion_coeffs=[],
        intrinsics=intrinsics, T_cn_cnm1=np.eye(4).tolist(),
    )  # fmt: skip
    lens = read_cameras(chain).cameras[1].lens
    plane = {"eucm": eucm, "ds": ds}[model](rays(), *own)
    expected = plane * (340.0, 341.0) + (630.2, 520.7)
    assert lens.max_px <= GOOD_PX
    assert off(lens.camera, rays(), expected) <= 1.01 * lens.max_px + 1e-6


def fisheye624(p: np.ndarray, params: list[float]) -> np.ndarray:
    """Project Aria's FisheyeRadTanThinPrism, term by term."""
    f, cx, cy, *rest = params
    k, (p0, p1), (s0, s1, s2, s3) = rest[:6], rest[6:8], rest[8:]
    a, b = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    r = np.hypot(a, b)
    th = np.arctan(r)
    thd = th + sum(c * th ** (2 * i + 3) for i, c in enumerate(k))
    xr, yr = thd * a / r, thd * b / r
    r2 = xr**2 + yr**2
    x = xr + p0 * (2 * xr**2 + r2) + 2 * p1 * xr * yr + s0 * r2 + s1 * r2**2
    y = yr + p1 * (2 * yr**2 + r2) + 2 * p0 * xr * yr + s2 * r2 + s3 * r2**2
    return np.stack([f * x + cx, f * y + cy], -1)


ARIA = [241.0, 318.5, 235.2, -0.025, 0.098, -0.067, 0.013, 0.002, -0.0006, 0.0008, -0.0003,
        0.0006, -0.0002, -0.0005, 0.0001]  # fmt: skip


def aria(folder: Path, **config: object) -> Path:
    pose = {"Translation": [0.1, 0.0, 0.02], "UnitQuaternion": [1.0, [0.0, 0.0, 0.0]]}
    first = {"Label": "camera-slam-left", "T_Device_Camera": pose, "Calibrated": True,
             "Projection": {"Name": "FisheyeRadTanThinPrism", "Params": ARIA}}  # fmt: skip
    other = first | {"Label": "camera-slam-right",
                     "T_Device_Camera": pose | {"Translation": [-0.03, 0.01, 0.02]}}  # fmt: skip
    path = folder / "calibration.json"
    path.write_text(json.dumps({"CameraCalibrations": [first | config, other]}))
    return path


def test_aria_is_fitted_within_the_stated_error(tmp_path: Path) -> None:
    left, right = read_cameras(aria(tmp_path)).cameras
    assert (left.camera.width, left.camera.height) == (640, 480)
    assert 0.0 < left.lens.rms_px < 0.4 < left.lens.max_px < 1.5
    assert off(left.camera, rays(), fisheye624(rays(), ARIA)) <= 1.01 * left.lens.max_px
    assert right.T_first_camera is not None
    np.testing.assert_allclose(right.T_first_camera[:3, 3], [-0.13, 0.01, 0.0], atol=1e-12)
    line = tmp_path / "online_calibration.jsonl"
    line.write_text((tmp_path / "calibration.json").read_text() + "\n{}\n")
    assert read_cameras(line).cameras[0].camera == left.camera
    data = {"label": "camera-slam-left", "projection_model_type": "CameraModelType.FISHEYE624",
            "projection_params": ARIA, "image_width": 640, "image_height": 480}  # fmt: skip
    (tmp_path / "hot3d.json").write_text(json.dumps(data))
    assert load_camera(tmp_path / "hot3d.json") == left.camera


def test_colmaps_pixels_begin_at_the_corner(tmp_path: Path) -> None:
    path = tmp_path / "cameras.txt"
    path.write_text("# comment\n3 OPENCV_FISHEYE 1280 1024 402 401 630.7 521.2 "
                    f"{' '.join(map(str, K4))}\n")  # fmt: skip
    assert load_camera(path) == KB


def test_colmaps_thin_prism_is_arias(tmp_path: Path) -> None:
    f, cx, cy, *rest = ARIA
    numbers = [f, f, cx + 0.5, cy + 0.5, *rest]
    path = tmp_path / "cameras.txt"
    path.write_text(f"1 RAD_TAN_THIN_PRISM_FISHEYE 640 480 {' '.join(map(str, numbers))}\n")
    lens = read_cameras(path).cameras[0].lens
    assert off(lens.camera, rays(), fisheye624(rays(), ARIA)) <= 1.01 * lens.max_px < 1.5


def test_opencv_pinhole_distortion_is_fitted(tmp_path: Path) -> None:
    D = [*RADTAN, 0.003]
    K = matrix(820.0, 818.0, 630.2, 520.7)
    path = storage(tmp_path / "c.yml", image_width=1280, image_height=1024, camera_matrix=K,
                   distortion_coefficients=D)  # fmt: skip
    lens = read_cameras(path).cameras[0].lens
    points = rays(0.7)
    expected, _ = cv2.projectPoints(points, *no_pose(), np.array(K), np.array(D))
    assert off(lens.camera, points, expected[:, 0]) <= 1.05 * lens.max_px < 2.0


def test_opencv_stereo_maps_the_first_camera_to_the_second(tmp_path: Path) -> None:
    R = mount_at((0, 0, 0), 4.0, 2.0, 91.0)[:3, :3]
    K = matrix(402.0, 401.0, 630.2, 520.7)
    path = storage(tmp_path / "s.yml", image_width=1280, image_height=1024, K1=K, D1=list(K4),
                   K2=K, D2=list(K4), R=R.tolist(), T=[[-0.35], [0.01], [0.02]])  # fmt: skip
    left, right = read_cameras(path).cameras
    assert left.camera == right.camera == KB
    place = right.T_first_camera
    assert place is not None
    np.testing.assert_allclose(inverse(place), rigid(R, np.array([-0.35, 0.01, 0.02])), atol=1e-12)


def test_opencv_numbers_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "stereo.xml"
    entry = (
        '<{0} type_id="opencv-matrix"><rows>{1}</rows><cols>{2}</cols><dt>d</dt>'
        "<data>{3}</data></{0}>"
    )
    path.write_text(
        '<?xml version="1.0"?><opencv_storage><image_width>160</image_width>'
        + "<image_height>128</image_height>"
        + entry.format("R", 3, 3, "1. 0. 0. 0. 1. 0. 1e999 0. 1.")
        + entry.format("T", 3, 1, "-0.3 0. 0.")
        + "</opencv_storage>"
    )
    with pytest.raises(FileError, match="key 'R': holds numbers that are not finite"):
        read_cameras(path)


def test_opencv_coefficients_of_no_model_are_refused(tmp_path: Path) -> None:
    values = {"camera_matrix": matrix(402.0, 401.0, 630.2, 520.7), "image_width": 1280,
              "image_height": 1024, "fisheye_model": 0}  # fmt: skip
    for count in (3, 7, 14):
        path = storage(tmp_path / "c.yml", distortion_coefficients=[0.01] * count, **values)
        with pytest.raises(FileError, match=rf"{count} coefficients \(valid: 4, 5, 8 or 12"):
            load_camera(path)


def test_an_aria_file_keeps_the_field_of_view(tmp_path: Path) -> None:
    narrow = dataclasses.replace(KB, max_angle=1.2)
    files, _ = format_cameras(
        CameraSet((SetCamera("one", exact(narrow)),)), "aria", tmp_path / "a.json"
    )
    ((path, text),) = files.items()
    path.write_text(text)
    assert read_cameras(path).cameras[0].camera.max_angle == pytest.approx(1.2)


def test_four_opencv_coefficients_need_to_be_told(tmp_path: Path) -> None:
    K = matrix(402.0, 401.0, 630.2, 520.7)
    values = {"camera_matrix": K, "distortion_coefficients": list(K4)}
    path = storage(tmp_path / "c.yml", image_width=1280, image_height=1024, **values)
    with pytest.raises(FileError, match=r"distortion_coefficients.*fisheye_model"):
        load_camera(path)
    path = storage(tmp_path / "c.yml", fisheye_model=1, **values)
    with pytest.raises(FileError, match=r"image_width.*--size"):
        load_camera(path)
    assert read_cameras(path, (1280, 1024)).cameras[0].camera == KB


def test_ros_camera_info(tmp_path: Path) -> None:
    path = tmp_path / "left.yaml"
    path.write_text(
        "image_width: 1280\nimage_height: 1024\ncamera_name: left\ncamera_matrix:\n  rows: 3\n"
        "  cols: 3\n  data: [402, 0, 630.2, 0, 401, 520.7, 0, 0, 1]\n"
        "distortion_model: equidistant\ndistortion_coefficients:\n  rows: 1\n  cols: 4\n"
        f"  data: {list(K4)}\n"
    )
    assert load_camera(path) == KB


def stereo() -> Rig:
    one = Camera("kannala_brandt", 1280, 1024, (630.2, 520.7), ((402, 0), (0, 401)), K4, 1.6)
    other = Camera("kannala_brandt", 1280, 1024, (640.0, 500.5), ((399, 0), (0, 400)), K4, 1.6)
    left, right = mount_at((0.3, 0.17, 0.1), 82.0, 4.0), mount_at((0.31, -0.17, 0.1), 80.0, -5.0)
    return Rig("helmet", (Mount("left", one, left), Mount("right", other, right)))


@pytest.mark.parametrize("format", WRITERS)
def test_what_is_written_is_read_back(tmp_path: Path, format: str) -> None:
    rig = stereo()
    suffix = {"aria": ".json", "unrealego": ".json", "colmap": ".txt", "ocam": ".txt",
              "opencv-xml": ".xml"}.get(format, ".yaml")  # fmt: skip
    files, worst = format_cameras(CameraSet.of(rig), format, tmp_path / f"out{suffix}")
    found = []
    for path, text in files.items():
        path.write_text(text)
        found += read_cameras(path).cameras
    assert len(found) == 2
    limit = worst + 1e-6
    assert limit < (0.3 if format in ("ocam", "unrealego") else 1e-5)
    for camera, back in zip(rig.cameras, found, strict=True):
        assert off(back.camera, rays(), camera.project(rays())[0]) < limit
    if format in ("kalibr", "opencv", "opencv-xml", "aria"):
        T = inverse(rig.T_head_camera[0]) @ rig.T_head_camera[1]
        assert found[1].T_first_camera is not None
        np.testing.assert_allclose(found[1].T_first_camera, T, atol=1e-9)


def test_a_rig_file_is_read_back_exactly(tmp_path: Path) -> None:
    rig = stereo()
    (tmp_path / "rig.toml").write_text(format_rig(rig))
    back = load_rig(tmp_path / "rig.toml")
    assert (back.name, back.views, back.cameras) == (rig.name, rig.views, rig.cameras)
    np.testing.assert_allclose(back.T_head_camera, rig.T_head_camera, atol=1e-15)


def test_cameras_without_a_head_are_no_rig(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="egocap rig convert"):
        load_rig(kalibr(tmp_path))
    two = kalibr(tmp_path, T_cn_cnm1=np.eye(4).tolist())
    with pytest.raises(FileError, match="holds 2 cameras: cam0, cam1"):
        load_camera(two)


def test_a_guessed_mount_looks_down_before_the_head() -> None:
    found = CameraSet.of(stereo()).rig("guess").T_head_camera
    np.testing.assert_allclose(found[:, :3, 3].mean(0), [0.25, 0.0, 0.10], atol=1e-9)
    assert found[0, 1, 3] > 0.16 and found[1, 1, 3] < -0.16  # left, right
    assert found[:, 2, 2].max() < -0.95  # both look down
    assert found[:, 1, 0].max() < -0.95  # the image's right is the head's


@pytest.mark.parametrize(
    ("second", "right"),
    [
        ([-0.3, 0.0, 0.0], [1.0, 0.0]),  # left in the picture: this is the left one
        ([0.0, 0.3, 0.0], [0.0, 1.0]),  # below, cameras mounted upright: the first is the left one
        ([0.0, 0.0, 0.3], [1.0, 0.0]),  # along the axis: the picture's right
    ],
)
def test_a_guessed_mount_of_two_cameras_in_a_line(second: list[float], right: list[float]) -> None:
    one = CameraSet.of(stereo()).cameras[0]
    place = rigid(np.eye(3), np.array(second))
    pair = (one, dataclasses.replace(one, name="other", T_first_camera=place))
    found = CameraSet(pair).rig("guess").T_head_camera[0]
    np.testing.assert_allclose(found[:3, :2] @ right, [0.0, -1.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"intrinsics": [1.0]}, "cam0.*'pinhole' has 4 intrinsics"),
        ({"distortion_model": "equidistant", "distortion_coeffs": [0.1]}, "4 distortion_coeffs"),
        ({"resolution": "big"}, "cam0.resolution"),
        ({"camera_model": "pinhole-equi"}, "cam0.camera_model"),
        ({"camera_model": "omni", "intrinsics": [1.0, 1e-6, 1e-6, 5.0, 5.0],
          "distortion_model": "none", "distortion_coeffs": []}, "cam0"),
    ],
)  # fmt: skip
def test_kalibr_errors_name_the_key(tmp_path: Path, change, message) -> None:
    path = kalibr(tmp_path)
    data = yaml.safe_load(path.read_text())
    data["cam0"] |= change
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(FileError, match=message):
        load_camera(path)


@settings(max_examples=60, deadline=None)
@given(
    base=st.sampled_from(["kalibr", "ros", "opencv", "colmap", "aria"]),
    cut=st.integers(0, 400), junk=st.text(max_size=12),
)  # fmt: skip
def test_damaged_files_give_our_errors(tmp_path_factory, base: str, cut: int, junk: str) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    suffix = {"aria": ".json", "colmap": ".txt"}.get(base, ".yaml")
    each = CameraSet((SetCamera("a", exact(KB), np.eye(4)),))
    files, _ = format_cameras(each, base, folder / f"x{suffix}")
    ((path, text),) = files.items()
    path.write_text(text[:cut] + junk + text[cut + 3 :], encoding="utf-8")
    try:
        read_cameras(path)
    except EgocapError as error:
        assert str(path) in str(error)
