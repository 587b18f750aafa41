"""Recordings for the viewer hold the motion that was given, read back by Rerun's own reader."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.labels import LABELS, LIMBS
from egocap.body.side_colours import LEFT, RIGHT
from egocap.data.sequence import Sequence
from egocap.data.track import load_track, save_track
from egocap.errors import FileError, InputError
from egocap.head_pose.result import HeadTrajectory
from egocap.view.viewer import open_all, view

pytest.importorskip("rerun")


def entities(path):
    """Columns of every entity: over time and static."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if ":" in name]  # not the time line
        table = {name: batch.column(name).to_pylist() for name in names}
        found.setdefault(str(chunk.entity_path), {}).update(table)
    return found


@pytest.fixture(scope="module")
def tracked(tiny_sequence, tmp_path_factory):
    """A track of the tiny sequence in the world, on disk."""
    from egocap.body.proportions import Proportions
    from egocap.data.head_pose import HeadPoses, in_world
    from egocap.detect.sources import detections_from
    from egocap.track.tracker import Tracker

    sequence = Sequence(tiny_sequence)
    tracker = Tracker(sequence.rig, Proportions(sequence.body.offsets))
    track = tracker.track(detections_from(sequence, "simulated:2", 0))
    known = np.ones(len(track.times), bool)
    path = tmp_path_factory.mktemp("viewer") / "walk.npz"
    save_track(path, in_world(track, HeadPoses(sequence.truth.T_world_head, known)))
    return path


def test_head_poses_are_shown_with_the_surroundings(tiny_sequence, tracked, tmp_path):
    truth = Sequence(tiny_sequence).truth
    points = np.random.default_rng(0).normal(size=(20, 3))
    heads = HeadTrajectory(np.arange(len(truth.time)), truth.time, truth.T_world_head,
                           points=points)  # fmt: skip
    heads.save(tmp_path / "head.npz")
    for what in ([tmp_path / "head.npz"], [tracked, tmp_path / "head.npz"]):
        view(what, tmp_path / "head.rrd")
        found = entities(tmp_path / "head.rrd")
        shown = np.array(found["/space/surroundings"]["Points3D:positions"][0], float)
        np.testing.assert_allclose(shown, points, atol=1e-5)
        way, floor = found["/space/path"]["LineStrips3D:strips"][0]
        np.testing.assert_allclose(way, truth.T_world_head[:, :3, 3], atol=1e-5)
        np.testing.assert_allclose(np.array(floor)[:, 2], 0.0)
    local = replace(load_track(tracked), T_world_head=None, joints_world=None, in_world=None)
    save_track(tmp_path / "local.npz", local)
    with pytest.raises(InputError, match="beside a motion in the head frame"):
        open_all([tmp_path / "local.npz", tmp_path / "head.npz"])
    with pytest.raises(InputError, match="a second one of its kind"):
        open_all([tmp_path / "head.npz", tmp_path / "head.npz"])


def test_space_holds_the_joints_and_their_sides(tiny_sequence, tracked, tmp_path):
    out = tmp_path / "walk.rrd"
    view([tiny_sequence, tracked], out)
    found, track = entities(out), load_track(tracked)
    joints = np.array(found["/space/walk/joints"]["Points3D:positions"], float)
    np.testing.assert_allclose(joints, track.joints_world, atol=1e-5)
    limbs = np.array(found["/space/walk/limbs"]["LineStrips3D:strips"], float)
    np.testing.assert_allclose(limbs, track.joints_world[:, np.array(LIMBS)], atol=1e-5)
    truth = np.array(found["/space/truth/joints"]["Points3D:positions"], float)
    np.testing.assert_allclose(truth, Sequence(tiny_sequence).truth.joints_world, atol=1e-5)
    colours = found["/space/walk/joints"]["Points3D:colors"][0]
    for side, rgb in (("left", LEFT), ("right", RIGHT)):
        r, g, b = rgb
        packed = (r << 24) + (g << 16) + (b << 8) + 255
        assert colours[LABELS.index(f"{side}_knee")] == packed


def test_the_head_moves_and_ellipsoids_are_the_covariance(tiny_sequence, tracked, tmp_path):
    out = tmp_path / "walk.rrd"
    view([tiny_sequence, tracked], out, images=False)
    found, track = entities(out), load_track(tracked)
    moved = np.array(found["/space/head"]["Transform3D:mat3x3"], float).reshape(-1, 3, 3)
    np.testing.assert_allclose(np.swapaxes(moved, 1, 2), track.T_world_head[:, :3, :3], atol=1e-6)
    drawn = found["/space/walk/uncertainty"]
    half = np.array(drawn["Ellipsoids3D:half_sizes"], float)
    x, y, z, w = np.moveaxis(np.array(drawn["Ellipsoids3D:quaternions"], float), -1, 0)
    turn = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], -1)
    R = track.T_world_head[:, None, :3, :3]
    covariance = R @ track.covariance @ np.swapaxes(R, -1, -2)
    variance = np.einsum("tji,tjik,tjk->tj", turn, covariance, turn)  # along the first half axis
    np.testing.assert_allclose(np.sqrt(variance), half[..., 0] / 2, rtol=0.02, atol=2e-4)


def test_images_and_overlays_agree_with_the_rig(tiny_sequence, tracked, tmp_path):
    import cv2

    out = tmp_path / "walk.rrd"
    view([tiny_sequence, tracked], out)
    found, sequence = entities(out), Sequence(tiny_sequence)
    blob = np.array(found["/views/left"]["EncodedImage:blob"][0], np.uint8).ravel()
    image = cv2.imdecode(blob, cv2.IMREAD_COLOR)[..., ::-1].astype(float)
    height, width = image.shape[:2]
    given = cv2.resize(sequence.images(0)[0], (width, height), interpolation=cv2.INTER_AREA)
    assert np.abs(image - given).mean() < 8
    points = np.array(found["/views/left/truth/joints"]["Points2D:positions"][0], float)
    pixels, inside = sequence.rig.project(sequence.truth.joints_head[0])
    scale = height / sequence.rig.cameras[0].height
    np.testing.assert_allclose(points[inside[0]], (pixels[0][inside[0]] + 0.5) * scale, atol=1e-3)
    assert np.isnan(points[~inside[0]]).all()


def test_a_track_alone_is_shown_in_the_world_and_beside_a_local_one_in_the_head(tracked, tmp_path):
    from dataclasses import replace

    local = replace(load_track(tracked), T_world_head=None, joints_world=None)
    save_track(tmp_path / "local.npz", local)
    assert open_all([tracked]).in_world
    both = open_all([tracked, tmp_path / "local.npz"])
    assert not both.in_world
    assert both.floor == pytest.approx(local.joints_head[..., 2].min())


def test_what_cannot_be_shown_is_refused(tiny_sequence, tmp_path):
    with pytest.raises(InputError, match="second"):
        open_all([tiny_sequence, tiny_sequence])
    with pytest.raises(InputError, match=r"\.rrd"):
        view([tiny_sequence], tmp_path / "walk.html")
    with pytest.raises(FileError):
        open_all([tmp_path / "absent.npz"])
    (tmp_path / "noise.npz").write_bytes(b"noise")
    with pytest.raises(FileError):
        open_all([tmp_path / "noise.npz"])
