"""Mo2Cap2: HDF5 chunks round trip through the cropped lens; test sequences give unaligned poses."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from egocap.body.labels import LABEL_INDEX
from egocap.datasets.calibration import SHIPPED
from egocap.datasets.mo2cap2 import recordings, small_camera
from egocap.errors import FileError
from tests.egocap.datasets.miniature import MO2CAP2

INDEX = [LABEL_INDEX[label] for label in MO2CAP2]


@pytest.fixture
def root(tmp_path):
    text = (SHIPPED / "egowholemocap_fisheye.json").read_text()
    (tmp_path / "fisheye.calibration.json").write_text(text)
    return tmp_path


@pytest.fixture
def small(shoot, ocam):
    return shoot([small_camera(ocam("egowholemocap_fisheye"))], [np.eye(4)])


def write_chunk(shot, path):
    """Annot2D is 33 pixels to the right of the image; millimetres; images (3, 256, 256)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        file["Annot3D"] = 1000 * shot.camera[:, 0, INDEX]
        file["Annot2D"] = shot.pixels[:, 0, INDEX] + [33.0, 0.0]
        images = [np.moveaxis(shot.image(t, 0), -1, 0) for t in range(len(shot))]
        file["Images"] = np.array(images)


def test_chunk_round_trip(root, small, check):
    write_chunk(small, root / "training_data/mo2cap2_chunk_0001.hdf5")
    (recording,) = recordings("mo2cap2", root)
    check(recording, small, MO2CAP2, world=False)
    assert recording.name == "mo2cap2_chunk_0001"
    (alone,) = recordings("mo2cap2", root / "training_data/mo2cap2_chunk_0001.hdf5")
    assert len(alone) == len(recording)


def test_the_small_camera_sees_the_middle_of_the_full_image_at_a_quarter(ocam):
    full = ocam("egowholemocap_fisheye")
    points = np.random.default_rng(0).normal(size=(50, 3)) + [0, 0, 2.0]
    large, small = full.project(points)[0], small_camera(full).project(points)[0]
    assert np.allclose((large[:, 0] + 0.5 - 128) / 4 - 0.5, small[:, 0])
    assert np.allclose((large[:, 1] + 0.5) / 4 - 0.5, small[:, 1])


@pytest.fixture
def outdoor(root, shoot, ocam):
    shot = shoot([ocam("egowholemocap_fisheye")], [np.eye(4)])
    folder = root / "TestSet/olek_outdoor"
    for t in range(len(shot)):
        shot.write(folder / f"fc2_save_2017-11-08-162032-{158 + t:04d}.jpg", t, 0)
    poses = 1000 * shot.world[:, INDEX]  # any frame of reference; more poses than images
    savemat(root / "TestSet/olek_outdoor_gt.mat", {"pose_gt": np.concatenate([poses, poses])})
    return shot


def test_test_sequence(root, outdoor):
    (recording,) = recordings("mo2cap2", root)
    assert not recording.known_frame and len(recording) == len(outdoor)
    found = recording.labels.joints_head[:, INDEX]
    assert np.abs(found - outdoor.world[:, INDEX]).max() < 1e-5
    assert recording.labels.labelled.sum() == 15 * len(outdoor)
    assert not recording.labels.in_view.any() and recording.reprojection_px() is None
    assert np.array_equal(recording.images(2)[0], outdoor.image(2, 0))


def test_missing_and_foreign_parts_are_named(root, small, outdoor):
    chunk = root / "mo2cap2_chunk_0001.hdf5"
    write_chunk(small, chunk)
    with h5py.File(chunk, "a") as file:
        del file["Annot3D"]
    with pytest.raises(FileError, match=r"key 'Annot3D'.*another version"):
        list(recordings("mo2cap2", chunk))
    chunk.write_bytes(b"no HDF5")
    with pytest.raises(FileError, match="not an HDF5 file"):
        list(recordings("mo2cap2", chunk))
    chunk.unlink()
    poses = root / "TestSet/olek_outdoor_gt.mat"
    (root / "TestSet/olek_outdoor/fc2_save_2017-11-08-162032-0160.jpg").unlink()
    with pytest.raises(FileError, match="images in between are missing"):
        list(recordings("mo2cap2", root))
    savemat(poses, {"other": np.zeros(3)})
    with pytest.raises(FileError, match="key 'pose_gt'"):
        list(recordings("mo2cap2", root))
    poses.write_bytes(b"MATLAB 7.3 MAT-file")
    with pytest.raises(FileError, match="not a MAT file"):
        list(recordings("mo2cap2", root))
