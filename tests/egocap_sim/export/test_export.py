"""Exports read back by code that knows the formats, not us: json, OpenCV, closed forms."""

import json
import resource
import shutil
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.cameras.camera import Camera
from egocap.cameras.camera_files import load_camera
from egocap.cameras.ocam_files import ocam_calibration
from egocap.cameras.rig_files import load_rig
from egocap.data.sequence import Sequence
from egocap.data.truth import OUT_OF_VIEW, VISIBLE
from egocap.datasets.catalogue import open_dataset
from egocap.errors import InputError, MachineError
from egocap.geometry import transform
from egocap_sim.core.resources import builtin_file
from egocap_sim.export.formats import FORMATS, export
from egocap_sim.export.unrealego import JOINTS
from egocap_sim.scene.rig_sampler import sample_rig


@pytest.fixture(scope="module")
def sequence(tiny_sequence: Path) -> Sequence:
    return Sequence(tiny_sequence)


def test_coco_says_what_the_truth_says(sequence, tmp_path):
    export(sequence, "coco", tmp_path / "coco")
    content = json.loads((tmp_path / "coco" / "annotations.json").read_text())
    (category,) = content["categories"]
    assert category["keypoints"] == list(LABELS)
    names = {tuple(category["keypoints"][i - 1] for i in pair) for pair in category["skeleton"]}
    assert ("left_elbow", "left_wrist") in names
    assert len(content["images"]) == len(content["annotations"]) == 2 * len(sequence)
    images = {image["id"]: image for image in content["images"]}
    truth = sequence.truth
    for annotation in content["annotations"]:
        image = images[annotation["image_id"]]
        t, v = image["frame"], sequence.manifest.views.index(image["view"])
        assert image["id"] == 2 * t + v + 1  # as `egocap export` numbers detections
        picture = cv2.imread(str(tmp_path / "coco" / image["file_name"]))[..., ::-1]
        assert picture.shape == (image["height"], image["width"], 3)
        assert np.array_equal(picture, sequence.frame(t).images[v])
        points = np.array(annotation["keypoints"]).reshape(18, 3)
        assert np.array_equal(points[:, 2] == 2, truth.visibility[t, v] == VISIBLE)
        labelled = truth.visibility[t, v] != OUT_OF_VIEW
        assert np.array_equal(points[:, 2] > 0, labelled)
        assert annotation["num_keypoints"] == labelled.sum()
        assert np.abs(points[labelled, :2] - truth.joints_2d[t, v, labelled]).max() < 1e-3
        assert not points[~labelled].any()
        x, y, w, h = annotation["bbox"]
        assert 0 <= x < x + w <= image["width"] and 0 <= y < y + h <= image["height"]
        seen = points[points[:, 2] == 2, :2]
        inside = (seen > [x - 4, y - 4]).all(1) & (seen < [x + w + 4, y + h + 4]).all(1)
        assert inside.all() and 0 < annotation["area"] <= w * h


def test_unrealego_has_the_pose_in_centimetres_three_times_over(sequence, tmp_path):
    out = tmp_path / "unrealego"
    export(sequence, "unrealego", out)
    (place,) = (out / "train.txt").read_text().split()
    folder = out / place
    assert len(Path(place).parts) == 6 and Path(place).parts[1] == "Day"
    truth = sequence.truth
    assert len(list((folder / "json").iterdir())) == len(sequence)
    for t in range(len(sequence)):
        frame = json.loads((folder / "json" / f"frame_{t}.json").read_text())
        joints = frame["joints"]
        assert joints.keys() == JOINTS.keys() | {"pelvis"} and len(JOINTS) == 16
        head = np.mean([frame[f"camera_{side}"]["trans"] for side in ("left", "right")], 0)
        assert head[2] == pytest.approx(100 * truth.T_world_head[t, 2, 3] + 14, abs=8)
        for name, label in JOINTS.items():
            j = LABEL_INDEX[label]
            world = np.multiply(joints[name]["trans"], [1, -1, 1])  # Unreal's is left-handed
            assert world == pytest.approx(100 * truth.joints_world[t, j])
            for v, side in enumerate(("left", "right")):
                point = np.array(joints[name][f"camera_{side}_pts3d"])
                assert point == pytest.approx(100 * truth.joints_camera[t, v, j])
                camera = frame[f"camera_{side}"]
                away = np.linalg.norm(np.subtract(joints[name]["trans"], camera["trans"]))
                assert np.linalg.norm(point) == pytest.approx(away)  # one geometry throughout
        for side in ("left", "right"):
            image = cv2.imread(
                str(folder / "fisheye_final_image" / f"camera_{side}" / f"final_{t}.png")
            )
            view = ("left", "right").index(side)
            assert np.array_equal(image[..., ::-1], sequence.frame(t).images[view])
            depth = cv2.imread(
                str(folder / "fisheye_depth_image" / f"camera_{side}" / f"depth_{t}.png"),
                cv2.IMREAD_UNCHANGED,
            )
            assert np.array_equal(depth, sequence.depth(t, side))


def test_unrealego_has_no_labels_of_other_pictures(sequence, tmp_path, monkeypatch):
    dropped = np.zeros((len(sequence), 2), bool)
    dropped[2, 1] = True
    monkeypatch.setattr(Sequence, "sensor", SimpleNamespace(dropped=dropped))
    export(Sequence(sequence.folder), "unrealego", tmp_path / "out")
    numbers = sorted(path.stem for path in tmp_path.rglob("frame_*.json"))
    assert len(numbers) == len(sequence) - 1 and "frame_2" not in numbers


def test_names_of_the_sequence_lead_nowhere_else(tiny_sequence, tmp_path):
    shutil.copytree(tiny_sequence, tmp_path / "seq")
    path = tmp_path / "seq/manifest.json"
    manifest = json.loads(path.read_text())
    manifest["config"]["place"]["name"] = manifest["config"]["motion"]["name"] = ".."
    path.write_text(json.dumps(manifest))
    out = tmp_path / "a/b/out"
    out.parent.mkdir(parents=True)
    export(Sequence(tmp_path / "seq"), "unrealego", out)
    assert [p.name for p in out.parent.iterdir()] == ["out"]
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["b"]


def test_unreal_rotations_turn_the_camera_to_its_points(sequence, tmp_path):
    export(sequence, "unrealego", tmp_path / "unrealego")
    (path,) = (tmp_path / "unrealego").rglob("frame_3.json")
    frame = json.loads(path.read_text())
    for side in ("left", "right"):
        camera = frame[f"camera_{side}"]
        (sp, sy, sr), (cp, cy, cr) = (f(np.radians(camera["rot"])) for f in (np.sin, np.cos))
        axes = np.array([[cp * cy, cp * sy, sp],
                         [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, -sr * cp],
                         [-(cr * sp * cy + sr * sy), cy * sr - cr * sp * sy, cr * cp]])  # fmt: skip
        for joint in frame["joints"].values():  # FRotationMatrix: rows are the axes
            forward, right, up = axes @ np.subtract(joint["trans"], camera["trans"])
            assert joint[f"camera_{side}_pts3d"] == pytest.approx([right, -up, forward], abs=1e-6)


def test_the_reader_of_the_data_set_reads_the_export(sequence, tmp_path):
    export(sequence, "unrealego", tmp_path / "unrealego")
    (recording,) = open_dataset(f"unrealego2:{tmp_path}/unrealego")
    truth, labels = sequence.truth, recording.labels
    index = [LABEL_INDEX[label] for label in JOINTS.values()]
    for v, T_camera_head in enumerate(recording.rig.T_camera_head):
        camera = transform(T_camera_head, labels.joints_head)
        assert np.abs(camera - truth.joints_camera[:, v])[:, index].max() < 1e-5
        assert np.array_equal(recording.images(2)[v], sequence.frame(2).images[v])
    world = transform(labels.T_world_head, labels.joints_head)
    assert np.abs(world - truth.joints_world)[:, index].max() < 1e-5
    apart = np.abs(labels.points - truth.joints_2d)[labels.in_view]
    assert apart.max() < 0.01 and recording.reprojection_px() < 0.1  # the lens is a fit


def test_the_calibration_beside_it_projects_the_points_it_came_with(sequence, tmp_path):
    out = tmp_path / "unrealego"
    export(sequence, "unrealego", out)
    (path,) = out.rglob("frame_3.json")
    frame = json.loads(path.read_text())
    for side in ("left", "right"):
        camera = load_camera(out / f"camera_{side}.json")
        for name in JOINTS:
            joint = frame["joints"][name]
            pixel, valid = camera.project(np.array(joint[f"camera_{side}_pts3d"]))
            if valid:
                assert pixel == pytest.approx(joint[f"camera_{side}_pts2d"], abs=0.05)


@pytest.mark.parametrize("seed", range(12))
def test_any_lens_is_an_ocam_lens_to_a_tenth_of_a_pixel(seed, tmp_path):
    """Both polynomials, evaluated as OCamCalib defines them."""
    cameras: list[Camera] = [*sample_rig(np.random.default_rng(seed)).cameras]
    cameras += load_rig(builtin_file("rig", "egorig1")).cameras[:1]
    for camera in cameras:
        data = ocam_calibration(camera, "c")
        theta, turn = np.meshgrid(
            np.linspace(0.02, camera.max_angle - 0.01, 40), np.linspace(0, 6, 12)
        )
        points = np.stack(
            [np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)], -1
        )
        expected, _ = camera.project(points)
        rho = np.polynomial.polynomial.polyval(theta - np.pi / 2, data["polynomialW2C"])
        x, y = rho * np.cos(turn), rho * np.sin(turn)
        c, d, e = data["affine"]
        u, v = x + e * y + data["image_center"][0], d * x + c * y + data["image_center"][1]
        error = np.hypot(u - expected[..., 0], v - expected[..., 1])
        assert error.max() < 0.1
        z = -np.polynomial.polynomial.polyval(rho, data["polynomialC2W"])
        assert np.abs(np.arctan2(rho, z) - theta).max() < 3e-4  # rad; a tenth of a pixel
        assert data["imageCircleRadius"] > 100


def test_the_film_has_every_frame_at_the_right_rate_and_size(sequence, tmp_path):
    export(sequence, "mp4", tmp_path / "film.mp4")
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(30)
    frames = []
    while True:
        there, picture = film.read()
        if not there:
            break
        frames.append(picture)
    assert len(frames) == len(sequence)
    assert frames[0].shape == (128, 320, 3)
    left = sequence.frame(3).images[0].astype(int)
    assert np.abs(frames[3][:, :160, ::-1] - left).mean() < 20  # but for the drawn joints
    assert not list(tmp_path.glob("*.tmp*"))


def test_a_film_that_does_not_fit_is_an_error(sequence, tmp_path):
    """OpenCV ignores errors of writing; a limit of file size stands for a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, limits[1]))
    try:
        with pytest.raises(MachineError, match=r"film.mp4: .* of \d+ frames could be written"):
            export(sequence, "mp4", tmp_path / "film.mp4")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_written_is_refused(sequence, tmp_path):
    with pytest.raises(InputError, match="valid: coco, unrealego, mp4"):
        export(sequence, "voc", tmp_path / "x")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("mine")
    for form in ("coco", "unrealego"):
        with pytest.raises(InputError, match="not empty"):
            export(sequence, form, tmp_path / "full")
    with pytest.raises(InputError, match=r"ends in \.mp4"):
        export(sequence, "mp4", tmp_path / "film.avi")
    assert list(FORMATS) == ["coco", "unrealego", "mp4", "videos", "head-pose", "imu"]
