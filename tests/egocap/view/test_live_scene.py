"""The viewer of a live run is sent the poses with their pictures, read back by Rerun's reader."""

import os
import signal
import urllib.error
import urllib.request
from dataclasses import replace

import numpy as np
import pytest

from egocap.errors import MachineError
from egocap.track.online import OnlineTracker
from egocap.view import live_scene
from egocap.view.live_scene import LiveScene, LiveViewer
from egocap.view.live_view import PoseDisplay
from tests.egocap.conftest import make_motion

rr = pytest.importorskip("rerun")


@pytest.fixture(scope="module")
def poses():
    made = make_motion(frames=4)
    tracker, found = OnlineTracker(made.rig, made.person), made.detect("simulated:2")
    return [pose for t in range(4) for pose in tracker.step(found[t : t + 1])]


def recorded(path, poses, images, **scene):
    recording = rr.RecordingStream("test")
    content = recording.memory_recording()
    made = make_motion(frames=4)
    display = PoseDisplay(made.rig, scene=LiveScene(rr, recording, made.rig, **scene))
    for pose in poses:
        display(pose, images)
    recording.flush()
    path.write_bytes(content.drain_as_bytes())
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if ":" in name or name == "time":
                column = batch.column(name)
                rows = (column.cast("int64") if name == "time" else column).to_pylist()
                found.setdefault(str(chunk.entity_path), {}).setdefault(name, []).extend(rows)
    return found


def test_poses_come_with_their_times_and_pictures(poses, tmp_path):
    import cv2

    rng = np.random.default_rng(0)
    left = cv2.resize(rng.integers(0, 255, (8, 10, 3), np.uint8), (640, 512))
    found = recorded(tmp_path / "live.rrd", poses, [left, None])
    joints = np.array(found["/space/live/joints"]["Points3D:positions"], float)
    np.testing.assert_allclose(joints, [pose.joints_head for pose in poses], atol=1e-5)
    times = np.array(found["/space/live/joints"]["time"]) / 1e9
    np.testing.assert_allclose(times, [pose.time for pose in poses], atol=1e-8)
    half = np.array(found["/space/live/uncertainty"]["Ellipsoids3D:half_sizes"], float)
    variance = np.square(half / 2.0).sum(-1)
    np.testing.assert_allclose(
        variance, [np.trace(p.covariance, axis1=1, axis2=2) for p in poses], rtol=1e-3
    )
    rig = make_motion(frames=2).rig
    views = [f"/views/{view}" for view in rig.views]
    blobs = found[views[0]]["EncodedImage:blob"]
    shown = cv2.imdecode(np.array(blobs[0][0], np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert len(blobs) == 4 and shown.shape == (480, 600, 3)
    small = cv2.resize(left, (600, 480), interpolation=cv2.INTER_AREA)
    assert np.abs(shown.astype(float) - small).mean() < 6.0
    assert views[1] not in found
    pixels, inside = rig.project(poses[0].joints_head)
    drawn = np.array(found[f"{views[0]}/live/joints"]["Points2D:positions"][0], float)
    scale = 480 / 512
    np.testing.assert_allclose(drawn[inside[0]], (pixels[0][inside[0]] + 0.5) * scale, atol=1e-3)


def test_a_pose_is_shown_in_the_world_and_the_last_place_where_the_head_is_lost(poses, tmp_path):
    T = np.eye(4)
    T[:3, 3] = 1.0, 2.0, 1.6
    placed = [poses[0], replace(poses[1], T_world_head=T), *poses[2:]]
    found = recorded(tmp_path / "live.rrd", placed, [None, None], world=True)
    joints = np.array(found["/space/live/joints"]["Points3D:positions"], float)
    assert joints[0, :, 2].min() == pytest.approx(0.0, abs=1e-5)  # on the floor
    expected = [pose.joints_head + T[:3, 3] for pose in poses[1:]]
    np.testing.assert_allclose(joints[1:], expected, atol=1e-5)
    path, floor = found["/space/path"]["LineStrips3D:strips"][-1]
    np.testing.assert_allclose(np.array(floor)[:, 2], 0.0)
    np.testing.assert_allclose(path[1:], [T[:3, 3]] * 3, atol=1e-5)


def test_a_browser_gets_the_viewer_from_this_machine_alone(poses):
    viewer = LiveViewer(make_motion(frames=2).rig, "browser")
    try:
        viewer.show(poses[0], [None, None], 0.0)
        assert viewer.url.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(viewer.url.partition("?")[0], timeout=60) as page:
            assert page.status == 200 and b"<html" in page.read().lower()
        command = viewer._process.args
        assert command[command.index("--bind") + 1] == "127.0.0.1"
    finally:
        viewer.close()
    assert viewer._process.poll() is not None
    with pytest.raises(urllib.error.URLError):  # the server itself, too, not its script alone
        urllib.request.urlopen(viewer.url.partition("?")[0], timeout=60)


def test_a_closed_viewer_does_not_end_the_run(poses):
    viewer = LiveViewer(make_motion(frames=2).rig, "browser")
    os.killpg(viewer._process.pid, signal.SIGKILL)
    viewer._process.wait()
    viewer.show(poses[0], [None, None], 0.0)
    viewer.close()


def test_a_viewer_that_does_not_open_is_named(monkeypatch):
    def fails(port, page, where):
        return [live_scene.sys.executable, "-c", "raise SystemExit(1)"]

    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(MachineError, match="no display"):
        LiveViewer(make_motion(frames=2).rig, "window")
    monkeypatch.setattr(live_scene, "_command", fails)
    with pytest.raises(MachineError, match=r"did not open.*--viewer browser"):
        LiveViewer(make_motion(frames=2).rig, "browser")
