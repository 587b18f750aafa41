"""Rigs: where the cameras look, projection in the head frame, and the JSON round trip."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount, Rig
from egocap.cameras.rig_files import load_rig
from egocap.errors import FileError, InputError
from egocap.geometry import transform

RIGS = Path(__file__).parents[3] / "scenes" / "rigs"
LENS = Camera("equidistant", 640, 512, (319.5, 255.5), ((200.0, 0.0), (0.0, 200.0)), max_angle=1.6)


@pytest.fixture(params=["egorig1", "egorig2"])
def rig(request) -> Rig:
    return load_rig(RIGS / f"{request.param}.toml")


def test_the_papers_numbers() -> None:
    """Paper, section 5: 180 degrees, 1280 x 1024 at 30 Hz; section 3: baseline 30-40 cm."""
    rig = load_rig(RIGS / "egorig1.toml")
    assert rig.views == ("left", "right") and rig.frame_rate == 30.0
    assert {(c.width, c.height, c.max_angle) for c in rig.cameras} == {(1280, 1024, np.pi / 2)}
    left, right = rig.T_head_camera[:, :3, 3]
    np.testing.assert_allclose(left - right, [0, 0.35, 0], atol=1e-12)


def test_cameras_look_down_with_forward_up_in_the_image(rig: Rig) -> None:
    for T, camera in zip(rig.T_head_camera, rig.cameras, strict=True):
        axis = T[:3, 2]
        assert np.rad2deg(np.arcsin(-axis[2])) >= 60.0 and axis[0] > -1e-9
        below = T[:3, 3] + axis
        pixels, _ = Rig("one", (Mount("a", camera, T),)).project(
            np.stack([below, below + [0.1, 0, 0], below + [0, 0.1, 0]])
        )
        centre, ahead, left = pixels[0]
        np.testing.assert_allclose(centre, camera.centre, atol=1e-9)
        assert ahead[1] < centre[1] and left[0] < centre[0]


def test_the_two_views_mirror_each_other(rig: Rig) -> None:
    points = np.random.default_rng(0).uniform([0, -0.5, -1.5], [0.6, 0.5, -0.2], (40, 3))
    pixels, valid = rig.project(points)
    mirrored, valid_m = rig.project(points * [1, -1, 1])
    assert pixels.shape == (2, 40, 2)
    np.testing.assert_allclose(mirrored[1], [1279, 0] + pixels[0] * [-1, 1], atol=1e-9)
    np.testing.assert_array_equal(valid_m[1], valid[0])


# A person of 1.75 m standing; head frame (origin at the skull base, 1.54 m up), left side.
STANDING = {
    "neck": (-0.03, 0.0, -0.08), "shoulder": (-0.03, 0.18, -0.13), "elbow": (-0.04, 0.24, -0.42),
    "wrist": (0.03, 0.25, -0.67), "hand": (0.05, 0.25, -0.76), "hip": (-0.02, 0.09, -0.61),
    "knee": (0.0, 0.10, -1.04), "ankle": (-0.03, 0.10, -1.45), "foot": (0.12, 0.11, -1.51),
}  # fmt: skip
ARMS_FORWARD = {"elbow": (0.24, 0.2, -0.14), "wrist": (0.5, 0.2, -0.14), "hand": (0.6, 0.2, -0.14)}
ARMS_ASIDE = {
    "elbow": (-0.03, 0.47, -0.13), "wrist": (-0.03, 0.73, -0.13), "hand": (-0.03, 0.83, -0.13),
}  # fmt: skip
SQUATTING = {
    "hip": (-0.37, 0.1, -0.59), "knee": (0.08, 0.15, -0.54), "ankle": (-0.15, 0.12, -0.95),
    "foot": (0.02, 0.15, -1.01),
}  # fmt: skip


@pytest.mark.parametrize("change", [{}, ARMS_FORWARD, ARMS_ASIDE, SQUATTING])
def test_both_views_hold_the_whole_body(rig: Rig, change) -> None:
    left = np.array(list((STANDING | change).values()))
    _, valid = rig.project(np.concatenate([left, left * [1, -1, 1]]))
    assert valid.all()


def test_rays_hit_the_points_that_were_projected(rig: Rig) -> None:
    points = np.random.default_rng(1).uniform([0, -0.5, -1.5], [0.6, 0.5, -0.2], (4, 10, 3))
    pixels, _ = rig.project(points)
    origins, directions, valid = rig.rays(pixels)
    to_points = points - origins[:, None, None]
    distance = np.linalg.norm(to_points, axis=-1, keepdims=True)
    np.testing.assert_allclose(directions, to_points / distance, atol=1e-10)
    assert directions.shape == (2, 4, 10, 3) and valid.shape == (2, 4, 10)


def test_jacobian_is_the_derivative_in_the_head_frame(rig: Rig) -> None:
    points = np.random.default_rng(2).uniform([0, -0.5, -1.5], [0.6, 0.5, -0.2], (20, 3))
    pixels, J, _ = rig.project_jacobian(points)
    np.testing.assert_array_equal(pixels, rig.project(points)[0])
    for axis, step in enumerate(1e-6 * np.eye(3)):
        numeric = (rig.project(points + step)[0] - rig.project(points - step)[0]) / 2e-6
        np.testing.assert_allclose(J[..., axis], numeric, rtol=1e-5, atol=1e-3)


def test_torch_gives_the_same(rig: Rig) -> None:
    points = np.random.default_rng(3).uniform([0, -0.5, -1.5], [0.6, 0.5, -0.2], (2, 5, 3))
    pixels, J, valid = rig.project_jacobian(points)
    tensors = rig.project_jacobian(torch.from_numpy(points))
    for ours, theirs in zip((pixels, J, valid), tensors, strict=True):
        np.testing.assert_allclose(theirs.numpy(), ours, atol=1e-9)
    for ours, theirs in zip(rig.rays(pixels), rig.rays(tensors[0]), strict=True):
        np.testing.assert_allclose(theirs.numpy(), ours, atol=1e-12)


def test_project_is_the_camera_after_the_mount(rig: Rig) -> None:
    points = np.random.default_rng(4).normal(size=(30, 3))
    expected = [
        m.camera.project(transform(T, points))[0]
        for m, T in zip(rig.mounts, np.linalg.inv(rig.T_head_camera), strict=True)
    ]
    np.testing.assert_allclose(rig.project(points)[0], expected, atol=1e-8)


def test_resizing_halves_the_pixels(rig: Rig) -> None:
    points = np.array([[0.2, 0.1, -1.0], [0.0, -0.2, -0.5]])
    small = rig.resized(640, 512)
    assert {(c.width, c.height) for c in small.cameras} == {(640, 512)}
    np.testing.assert_allclose(
        small.project(points)[0], (rig.project(points)[0] + 0.5) / 2 - 0.5, atol=1e-9
    )


def test_json_round_trip_is_exact(rig: Rig, tmp_path: Path) -> None:
    rig.to_json(tmp_path / "rig.json")
    again = load_rig(tmp_path / "rig.json")
    assert again == rig
    again.to_json(tmp_path / "again.json")
    assert (tmp_path / "rig.json").read_bytes() == (tmp_path / "again.json").read_bytes()


@pytest.mark.parametrize(
    ("edit", "key"),
    [
        (lambda d: d.update(schema=2), "schema"),
        (lambda d: d.pop("schema"), "schema"),
        (lambda d: d.update(extra=1), "extra"),
        (lambda d: d["mounts"].clear(), "mounts"),
        (lambda d: d["mounts"][1].update(name="left"), "own name"),
        (lambda d: d["mounts"][1]["T_head_camera"].pop(), "mounts.1.T_head_camera"),
        (lambda d: d["mounts"][1]["T_head_camera"][0].__setitem__(0, 2.0), "rigid transform"),
        (lambda d: d["mounts"][1]["T_head_camera"][2].__setitem__(3, 1e308), "at most 10000 m"),
        (lambda d: d["mounts"][0]["camera"].update(width=-1), "mounts.0.camera.width"),
    ],
)
def test_damaged_json_names_file_and_key(rig: Rig, tmp_path: Path, edit, key: str) -> None:
    path = tmp_path / "rig.json"
    data = rig.to_dict()
    edit(data)
    path.write_text(json.dumps(data))
    with pytest.raises(FileError) as caught:
        load_rig(path)
    assert str(path) in str(caught.value) and key in str(caught.value)


def test_impossible_rigs_are_refused() -> None:
    mount = Mount("a", LENS, np.eye(4))
    for mounts in ((), (mount, mount)):
        with pytest.raises(InputError, match="views"):
            Rig("r", mounts)
    for T in (np.diag([1.0, 1, -1, 1]), np.eye(3), np.full((4, 4), np.nan)):
        with pytest.raises(InputError, match="T_head_camera of 'a'"):
            Mount("a", LENS, T)
