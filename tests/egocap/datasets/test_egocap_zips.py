"""EgoCap's published sets: the mirrored camera, the frame offset, the calibrations, zips."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.cameras.camera import Camera
from egocap.datasets.egocap_zips import recordings
from egocap.errors import FileError
from egocap.geometry import axis_angle, inverse, rigid, unit

POLYNOMIAL = (-400.0, 0.0, 9e-4, 1e-6, -1e-9)
T_CAM0_CAM1 = rigid(axis_angle(unit(np.array([0.4, 0.24, 0.88])), np.pi), [-0.02, 0.47, 0.02])
ORDER = [0, 1, 6, 7, 8, 9, 2, 3, 4, 5, 14, 15, 16, 17, 10, 11, 12, 13]  # the other side's joints
FIRST = 3922


@pytest.fixture
def shot(shoot):
    """Cameras at 1280 x 1024, images at half of it."""
    rows = ((1.0, 3e-4), (-2e-4, 0.9998))
    full = [Camera("ocam", 1280, 1024, centre, rows, POLYNOMIAL)
            for centre in ((650.0, 520.0), (630.5, 505.0))]  # fmt: skip
    small = [camera.resized(640, 512) for camera in full]
    roll = axis_angle(np.array([0.0, 0.0, 1.0]), 0.5 * np.pi)
    T_device_cam0 = rigid(roll, [-0.235, 0.0, 0.0])
    return shoot(small, [T_device_cam0, T_device_cam0 @ T_CAM0_CAM1])


def calibration(centre):
    """OCamCalib text: comments, lengths before the polynomials, centre as row and column."""
    forward = " ".join(map(str, (len(POLYNOMIAL), *POLYNOMIAL)))
    lines = (forward, "2 500.0 300.0", f"{centre[1]} {centre[0]}", "0.9998 -0.0002 0.0003",
             "1024 1280")  # fmt: skip
    return "".join(f"#comment\n\n{line}\n\n" for line in lines)


def extrinsics():
    flip = np.diag([1.0, 1.0, -1.0, 1.0])
    T = flip @ inverse(T_CAM0_CAM1) @ flip
    T[:3, 3] *= 1000.0
    rows = [" ".join(f"{x:.15E}" for x in M.ravel()) for M in (np.eye(4), T)]
    return "Skeletool Camera Calibration File V1.0\n" + "".join(
        f"name {v}\n  size 1280 1024\n  extrinsic {row}\n  radial 0\n" for v, row in enumerate(rows)
    )


def write_examples(shot, folder, subject, version):
    """dataset.txt: 24 lines an example; x from the image's corner; cam1 mirrored altogether."""
    lines = []
    for t in range(len(shot)):
        for v in (0, 1):
            n = FIRST + 4 * t - 85 * v
            name = f"./images/S{subject}_v{version}_cam{v}_frame-{n:04d}.jpg"
            shot.write(folder / name, t, v, mirrored=v == 1)
            points = shot.pixels[t, v] + 0.5
            if v == 1:
                points = (points * [-1, 1] + [640, 0])[ORDER]
            rows = [f"{j} {x:.4f} {y:.4f}" for j, (x, y) in enumerate(points)]
            lines += [f"# {len(lines)}", name, "3", "512", "640", "18", *rows]
    (folder / "dataset.txt").write_text("\n".join(lines) + "\n")


@pytest.fixture
def root(shot, tmp_path):
    write_examples(shot, tmp_path / "training_v000", 1, "000")
    write_examples(shot, tmp_path / "validation_v003_2D", 7, "003")
    folder = tmp_path / "validation_v003_3D"
    (folder / "cameraCalibration").mkdir(parents=True)
    for v, centre in enumerate(((650.0, 520.0), (630.5, 505.0))):
        path = folder / f"cameraCalibration/stereo_c0{v}_f_calibration.txt"
        path.write_text(calibration(centre))
    (folder / "cameraCalibration/calibrationFileV5.calibration").write_text(extrinsics())
    rows = ["Skeletool marker data", "Skeletool V1 18"]
    for t in range(len(shot)):
        n = FIRST + 4 * t
        rows.append(" ".join([str(n), *(f"{x:.5f}" for x in 1000 * shot.camera[t, 0].ravel())]))
        for v in (0, 1):
            shot.write(folder / f"images/franzi_01-cam{v}/frame-{n - 85 * v}.jpg", t, v)
    (folder / "dataset3D.mddd").write_text("\n".join(rows))
    return tmp_path


@pytest.mark.parametrize("zipped", [False, True])
def test_round_trip(zipped, root, shot, check):
    if zipped:
        for name in ("training_v000", "validation_v003_2D", "validation_v003_3D"):
            shutil.make_archive(str(root / name), "zip", root, name)
            shutil.rmtree(root / name)
    found = {recording.name: recording for recording in recordings("egocap", root)}
    assert list(found) == [
        "training_v000/S1/cam0", "training_v000/S1/cam1",
        "validation_v003_2D/S7/cam0", "validation_v003_2D/S7/cam1", "validation_v003_3D",
    ]  # fmt: skip
    poses = found["validation_v003_3D"]
    check(poses, shot, LABELS, world=False)
    assert poses.frames[0] == FIRST and poses.rig.views == ("cam0", "cam1")
    mounts = [replace(m, T_head_camera=shot.T_device_camera[v])
              for v, m in enumerate(poses.rig.mounts)]  # fmt: skip
    rig = replace(poses.rig, mounts=tuple(mounts))
    (other,) = recordings("egocap", root / "validation_v003_3D", rig)
    check(other, shot, LABELS, world=False)
    standing = np.median(poses.labels.joints_head, 0)
    assert standing[2, 1] > standing[6, 1] and standing[1, 2] > standing[10, 2]  # left, up
    for v in (0, 1):
        images = found[f"training_v000/S1/cam{v}"]
        assert np.abs(images.labels.points[:, 0] - shot.pixels[:, v]).max() < 0.01
        assert np.array_equal(images.images(3)[0], shot.image(3, v))
        assert not images.labels.labelled.any() and images.frames[0] == FIRST - 85 * v
        assert images.rig.views == (f"cam{v}",)


def test_one_set_may_be_named(root):
    (poses,) = recordings("egocap", root / "validation_v003_3D")
    shutil.rmtree(root / "validation_v003_2D")
    (alone,) = recordings("egocap", root / "validation_v003_3D")
    assert poses.labels.in_view.any() and not alone.labels.in_view.any()
    assert np.array_equal(poses.labels.joints_head, alone.labels.joints_head)


def test_missing_and_foreign_parts_are_named(root, tmp_path):
    def refused(match, path, content):
        kept = path.read_text()
        path.write_text(content(kept))
        with pytest.raises(FileError, match=match):
            list(recordings("egocap", root))
        path.write_text(kept)

    poses = root / "validation_v003_3D/dataset3D.mddd"
    refused(r"dataset3D\.mddd, line 3: 54 values", poses, lambda text: text.replace("3922 ", "", 1))
    refused("holds no pose", poses, lambda text: "header\n")
    refused("a frame is repeated", poses, lambda text: f"{text}\n{text.splitlines()[2]}")
    camera = root / "validation_v003_3D/cameraCalibration/calibrationFileV5.calibration"
    refused("no extrinsic of two cameras", camera, lambda text: text.replace("extrinsic", "x", 1))
    refused("not a rigid transform", camera, lambda text: text.replace("E-01", "E+00", 1))
    images = root / "training_v000/dataset.txt"
    refused("example 0'.*17 joints", images, lambda text: text.replace("\n0 ", "\n0", 1))
    refused("no image of the form", images, lambda text: text.replace("S1_v000", "image", 1))
    refused("has a frame twice", images, lambda text: text + text)
    refused("holds no example", images, lambda text: "")
    shutil.rmtree(root / "validation_v003_3D")
    with pytest.raises(FileError, match="neither this folder nor its"):
        list(recordings("egocap", root))
    with pytest.raises(FileError, match=r"none of EgoCap's sets"):
        list(recordings("egocap", tmp_path / "other"))
