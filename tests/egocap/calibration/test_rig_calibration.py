"""From simulated pictures of a board to a rig file; what users do wrong."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from egocap.boards.board import parse_board
from egocap.calibration import rig_calibration
from egocap.calibration.report.page import render_page
from egocap.calibration.report.rig_output import write_rig
from egocap.calibration.rig_calibration import calibrate
from egocap.cameras.rig_files import load_rig, parse_rig
from egocap.errors import FileError, InputError
from egocap.geometry import inverse
from egocap_sim.boards.record import record_board
from egocap_sim.boards.settings import BoardCamera, BoardRecording
from egocap_sim.core.resources import rig_file

BOARD = "charuco:4x5:0.05:0.037"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("boards") / "recording"
    rig = load_rig(rig_file("egorig1")).resized(640, 512)
    settings = BoardRecording(count=14, seed=2, camera=BoardCamera(samples=2, exposures=2))
    record_board(parse_board(BOARD), rig, settings, folder)
    return folder


@pytest.fixture(scope="module")
def calibration(recorded):
    return calibrate([recorded / "left", recorded / "right"], BOARD, model="equidistant")


def test_lenses_and_stereo_pose_are_the_rendered_ones(calibration, recorded):
    truth = parse_rig(json.loads((recorded / "truth.json").read_text())["rig"], "truth")
    for camera, mount in zip(calibration.rig.cameras, truth.mounts, strict=True):
        theta, azimuth = np.meshgrid(np.linspace(0, np.deg2rad(85), 20), np.linspace(0, 6.2, 12))
        rays = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth),
                         np.cos(theta)], -1)  # fmt: skip
        pixels, valid = mount.camera.project(rays)
        found, _ = camera.ray(pixels[valid])
        error = np.degrees(np.linalg.norm(found - rays[valid], axis=-1))
        assert (
            np.sqrt(np.mean(error**2)) < 0.15
        )  # a fifth of the pictures and half the pixels of a real calibration
        assert camera.max_angle == pytest.approx(mount.camera.max_angle, abs=np.deg2rad(3.0))
    T = inverse(truth.T_head_camera[1]) @ truth.T_head_camera[0]
    found = calibration.adjusted.state.T_view_rig[1]
    assert np.linalg.norm(found[:3, 3] - T[:3, 3]) < 0.8e-3
    turn, shift = calibration.pose_deviations(1)
    assert np.all(turn < np.deg2rad(0.1)) and np.all(shift < 1e-3)


@pytest.mark.parametrize("ending", [".toml", ".json"])
def test_rig_file_round_trip(calibration, tmp_path, ending):
    path = tmp_path / f"rig{ending}"
    write_rig(path, calibration.rig, calibration.notes)
    read = load_rig(path)
    assert read.cameras == calibration.rig.cameras
    assert np.allclose(read.T_head_camera, calibration.rig.T_head_camera, atol=1e-12)


def test_rig_names_of_any_script(calibration, tmp_path):
    rig = replace(calibration.rig, name='Helm "\N{GRINNING FACE}" \u6e2c')
    write_rig(tmp_path / "rig.toml", rig, calibration.notes)
    assert load_rig(tmp_path / "rig.toml").name == rig.name
    first, second = (tmp_path / "rig.toml").read_text(encoding="utf-8").splitlines()[:2]
    assert first == f"# {calibration.notes[0]}" and second == f"# {calibration.notes[1]}"


def test_page_shows_every_camera(calibration):
    page = render_page(calibration)
    assert page.count("data:image/svg+xml") == 5
    assert "left" in page and "standard deviation" in page


def test_mirrored_pictures_are_recognised(recorded, tmp_path):
    flip(recorded / "left", tmp_path / "left")
    with pytest.raises(FileError, match="mirrored"):
        calibrate([tmp_path / "left"], BOARD)


def test_moving_blur_is_recognised(recorded, tmp_path):
    kernel = np.zeros((31, 31), np.float32)
    np.fill_diagonal(kernel, 1 / 31)
    for path in sorted((recorded / "left").iterdir())[:6]:
        cv2.imwrite(str(tmp_path / path.name), cv2.filter2D(cv2.imread(str(path)), -1, kernel))
    with pytest.raises(FileError, match=r"found in 0 of 6 pictures: .*blurred.*held still"):
        calibrate([tmp_path], BOARD)


def test_board_of_other_counts_is_named(recorded):
    with pytest.raises(FileError, match=r"no lens explains .* lie as on charuco:4x\d"):
        calibrate([recorded / "left"], "charuco:5x4:0.05:0.037")


def test_pictures_without_a_board(tmp_path):
    rng = np.random.default_rng(0)
    for i in range(6):
        noise = cv2.resize(rng.integers(0, 255, (48, 64), np.uint8), (640, 480))
        cv2.imwrite(str(tmp_path / f"cat{i}.png"), noise)
    with pytest.raises(FileError, match=r"found in 0 of 6 pictures.*20 to 60 sharp pictures"):
        calibrate([tmp_path], BOARD)


def test_mixed_sizes(tmp_path):
    for i, width in enumerate((640, 640, 600)):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.zeros((480, width), np.uint8))
    with pytest.raises(FileError, match=r"2.png: is 600 x 480 .* 0.png 640 x 480"):
        calibrate([tmp_path], BOARD)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda folder: folder / "nothing", "no such"),
        (lambda folder: folder, "has no pictures"),
    ],
)
def test_missing_sources(tmp_path, make, said):
    with pytest.raises(FileError, match=said):
        calibrate([make(tmp_path)], BOARD)


def test_pictures_of_other_instants(recorded, tmp_path):
    (tmp_path / "right").mkdir()
    paths = sorted((recorded / "right").iterdir())
    for path, other in zip(paths, paths[5:] + paths[:5], strict=True):
        (tmp_path / "right" / path.name).write_bytes(other.read_bytes())
    with pytest.raises(InputError, match=r"right: only \d of \d+ pictures .*the same instants"):
        calibrate([recorded / "left", tmp_path / "right"], BOARD, model="equidistant")


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (lambda a, c: (replace(a, converged=False), c), "agree on no poses"),
        (lambda a, c: (a, c[c.view == 0]), "right: no corner agrees"),
    ],
)
def test_cameras_that_contradict_each_other(recorded, calibration, monkeypatch, fault, said):
    together = fault(calibration.adjusted, calibration.corners)
    views = iter(calibration.views)
    monkeypatch.setattr(rig_calibration, "calibrate_view", lambda *_: next(views))
    monkeypatch.setattr(rig_calibration, "_together", lambda *_: together)
    with pytest.raises(InputError, match=f"{said}.*the same instants"):
        calibrate([recorded / "left", recorded / "right"], BOARD, model="equidistant")


def flip(source: Path, target: Path) -> None:
    target.mkdir()
    for path in sorted(source.iterdir())[:6]:
        cv2.imwrite(str(target / path.name), cv2.imread(str(path))[:, ::-1])
