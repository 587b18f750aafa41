"""Live: the causal pass's poses, the newest picture wins, and sources that end or fail."""

import json
import threading
import time
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest

from egocap.cli.live import LiveOptions, _check, _print_live
from egocap.errors import InputError, MachineError
from egocap.pose.config import TrackerConfig
from egocap.track.online import OnlineTracker
from egocap.track.tracker import Tracker
from egocap.track.uncertainty import confidences
from egocap.view.capture import CameraSettings, Picture, Source, first_pictures, list_cameras
from egocap.view.feeds import LiveFeed, RecordedFeed, open_feed
from egocap.view.live_run import LiveReport, follow_live, warm_up
from tests.egocap.conftest import make_motion

LIVE = TrackerConfig(smoothing="none")
PARTS = ("times", "points", "sigma", "confidence", "valid")


def one(found, t):
    return replace(found, **{name: getattr(found, name)[t : t + 1] for name in PARTS})


@pytest.mark.parametrize("sources", [("0", "0"), ("1", "01")])
def test_a_camera_is_of_one_view(sources):
    with pytest.raises(InputError, match=r"camera \d is given for more than one view"):
        _check(sources, 2, LiveOptions(), TrackerConfig())
    _check(("0", "1"), 2, LiveOptions(), TrackerConfig())


def test_one_view_does_not_tell_metres():
    with pytest.raises(InputError, match="--world requires two views"):
        _check(("0",), 1, LiveOptions(world=True), TrackerConfig())
    _check(("0",), 1, LiveOptions(), TrackerConfig(smoothing="fixed-lag"))


def test_frame_by_frame_is_the_causal_pass():
    made = make_motion(frames=25)
    found = made.detect("simulated:2,swaps=0.1", hidden=0.2)
    whole = Tracker(made.rig, made.person, LIVE).track(found)
    live = OnlineTracker(made.rig, made.person, LIVE)
    poses = [pose for t in range(25) for pose in live.step(one(found, t))]
    assert np.allclose([p.angles for p in poses], whole.angles)
    confidence = np.array([p.confidence for p in poses])
    assert np.allclose(confidence, confidences(whole.covariance))
    assert (whole.confidence <= confidence + 1e-9).all()  # lowered by what the whole track shows
    with pytest.raises(InputError, match="later"):
        live.step(one(found, 3))
    with pytest.raises(InputError, match="at once"):
        live.step(found)


def video(path, frames, fps=30.0):
    """A clip whose frames tell their number by their brightness."""
    import cv2

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), fps, (64, 48))
    if not writer.isOpened():
        pytest.skip("no video writer here")
    for i in range(frames):
        writer.write(np.full((48, 64, 3), 10 * i % 250, np.uint8))
    writer.release()
    return str(path)


class Slow:
    """A detector that takes its time and says what it was given."""

    def __init__(self, made, seconds):
        self.found, self.seconds, self.calls = made.detect("simulated:2"), seconds, []

    def detect_images(self, images, when=0.0):
        time.sleep(self.seconds)
        self.calls.append([image is not None for image in images])
        return replace(one(self.found, len(self.calls) - 1), times=np.array([when]))


def test_a_slow_tracker_skips_pictures_and_does_not_fall_behind(tmp_path):
    made = make_motion(frames=60)
    sources = [Source(video(tmp_path / f"{side}.avi", 30)) for side in ("left", "right")]
    detector, times = Slow(made, 0.15), []
    tracker = OnlineTracker(made.rig, made.person, LIVE)
    report = follow_live(
        LiveFeed(sources), detector, tracker, lambda pose, images: times.append(pose.time)
    )
    for source in sources:
        source.close()
    assert 2 <= report.poses < 25
    assert report.skipped > 10
    fetched = sum(sum(call) for call in detector.calls)
    assert fetched + report.skipped == sum(source.taken for source in sources) == 60
    assert max(report.latencies) < 5.0
    assert len(times) == report.poses and (np.diff(times) > 0).all()


def test_the_head_is_found_in_the_pictures_that_are_tracked(tmp_path):
    made = make_motion(frames=60)
    names = [video(tmp_path / f"{side}.avi", 12) for side in ("left", "right")]

    class Placed:
        times, given = [], []

        def step(self, images, when, late):
            assert len(late) == len(images) == 2 and late[0] == 0.0
            self.times.append(when)
            self.given.append(np.eye(4) if len(self.times) > 4 else None)
            return self.given[-1]

        def facts(self):
            return {"frames": len(self.times)}

    head, poses = Placed(), []
    tracker = OnlineTracker(made.rig, made.person, replace(LIVE, smoothing="fixed-lag"))
    report = follow_live(
        RecordedFeed(names), Slow(made, 0.0), tracker,
        lambda pose, images: poses.append(pose), head=head,
    )  # fmt: skip
    assert [pose.time for pose in poses] == head.times and report.world == {"frames": 12}
    assert all(p.T_world_head is T for p, T in zip(poses, head.given, strict=True))
    assert len(report.stages["head"]) == 12 and report.summary()["world"] == {"frames": 12}


def test_files_that_play_by_the_clock_are_taken_when_their_rate_says(tmp_path):
    names = [video(tmp_path / f"{side}.avi", 10, fps=20.0) for side in ("left", "right")]
    with ExitStack() as stack:
        feed = open_feed(stack, names, CameraSettings(), lambda: False, realtime=True)
        instants = list(feed)
    times = np.array([instant.time for instant in instants])
    steps = np.diff(times) / 0.05
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
    late = np.array([instant.late for instant in instants]) / 0.05
    np.testing.assert_allclose(late, np.rint(late), atol=1e-6)
    assert late.max() == 0.0


def test_every_pose_is_shown_with_its_pictures(tmp_path):
    made = make_motion(frames=60)
    sources = [Source(video(tmp_path / f"{side}.avi", 5)) for side in ("left", "right")]
    shown = []
    report = follow_live(
        LiveFeed(sources), Slow(made, 0.0), OnlineTracker(made.rig, made.person, LIVE),
        on_pose=lambda pose, images: shown.append((pose, [i is not None for i in images])),
    )  # fmt: skip
    assert len(shown) == report.poses
    assert [True, True] in [there for _, there in shown]


def test_a_warm_up_leaves_the_tracker_as_it_is():
    made = make_motion(frames=4)
    config = TrackerConfig(smoothing="fixed-lag")
    tracker, fresh = (OnlineTracker(made.rig, made.person, config) for _ in range(2))
    detector = Slow(made, 0.0)
    warm_up(detector, tracker)
    assert detector.calls == [[True, True]]
    found = made.detect("simulated:2")
    for t in range(4):
        one_frame = found[t : t + 1]
        (own,), (other,) = tracker.step(one_frame), fresh.step(one_frame)
        assert np.array_equal(own.angles, other.angles)


def test_late_poses_are_shown_with_their_own_pictures(tmp_path):
    made = make_motion(frames=60)
    names = [video(tmp_path / f"{side}.avi", 12) for side in ("left", "right")]
    tracker = OnlineTracker(
        made.rig, made.person, TrackerConfig(smoothing="fixed-lag", lag=0.1)
    )  # fmt: skip
    shown = []
    report = follow_live(
        RecordedFeed(names), Slow(made, 0.0), tracker,
        on_pose=lambda pose, images: shown.append((pose.time, images[0].mean())),
    )  # fmt: skip
    np.testing.assert_allclose([when for when, _ in shown], np.arange(12) / 30.0, atol=1e-6)
    np.testing.assert_allclose([grey for _, grey in shown], 10.0 * np.arange(12), atol=3)
    assert len(report.latencies) == 9 and report.poses == 12
    assert {len(spent) for spent in report.stages.values()} == {12}
    assert list(report.stages) == ["pictures", "detect", "track", "show"]
    assert report.summary()["track_ms"] > 0.0


def test_a_run_whose_poses_all_come_at_the_end_has_no_latency_and_valid_json(tmp_path, capsys):
    made = make_motion(frames=60)
    names = [video(tmp_path / f"{side}.avi", 2) for side in ("left", "right")]
    tracker = OnlineTracker(made.rig, made.person, TrackerConfig(smoothing="fixed-lag", lag=0.1))
    report = follow_live(RecordedFeed(names), Slow(made, 0.0), tracker)
    assert report.poses == 2 and report.summary()["latency_ms"] is None
    json.dumps(report.summary(), allow_nan=False)
    json.dumps(LiveReport().summary(), allow_nan=False)
    _print_live(report, as_json=False)
    assert "2 poses" in (said := capsys.readouterr().out) and "latency unknown" in said


def test_an_error_in_detecting_or_showing_ends_the_run(tmp_path):
    made = make_motion(frames=60)
    names = [video(tmp_path / f"{side}.avi", 12) for side in ("left", "right")]

    class Broken(Slow):
        def detect_images(self, images, when=0.0):
            if len(self.calls) == 3:
                raise MachineError("out of order")
            return super().detect_images(images, when)

    def shut(pose, images):
        raise InputError("the page is gone")

    first, second = (OnlineTracker(made.rig, made.person, LIVE) for _ in range(2))
    with pytest.raises(MachineError, match="out of order"):
        follow_live(RecordedFeed(names), Broken(made, 0.0), first)
    with pytest.raises(InputError, match="page is gone"):
        follow_live(RecordedFeed(names), Slow(made, 0.0), second, shut)
    assert "detections" not in {thread.name for thread in threading.enumerate()}


def test_the_first_pictures_are_the_beginning(tmp_path):
    names = [video(tmp_path / "a.avi", 3), video(tmp_path / "b.avi", 30)]
    assert all(picture.mean() < 5 for picture in first_pictures(names))
    (tmp_path / "empty.avi").write_bytes(b"")
    with pytest.raises(InputError, match="empty"):
        first_pictures([str(tmp_path / "empty.avi")])


def test_settings_that_need_the_future_are_refused():
    made = make_motion(frames=2)
    for wrong in ({"smoothing": "interval"}, {"colour": True}):
        with pytest.raises(InputError, match="online tracking"):
            OnlineTracker(made.rig, made.person, replace(LIVE, **wrong))


def test_a_view_that_ends_early_is_missing(tmp_path):
    made = make_motion(frames=60)
    sources = [Source(video(tmp_path / "a.avi", 3)), Source(video(tmp_path / "b.avi", 12, 5.0))]
    detector = Slow(made, 0.02)
    follow_live(LiveFeed(sources), detector, OnlineTracker(made.rig, made.person, LIVE))
    assert [False, True] in detector.calls


class Paced:
    """A source that gives a picture at a rate [Hz]; 0: it hangs."""

    skipped, exhausted = 0, False

    def __init__(self, rate):
        self.rate, self.began, self.given = rate, time.monotonic(), 0

    def newest(self, timeout):
        due = self.began + (self.given + 1) / self.rate if self.rate else np.inf
        time.sleep(min(max(due - time.monotonic(), 0.0), timeout))
        if time.monotonic() < due:
            return None
        self.given = int((time.monotonic() - self.began) * self.rate)
        return Picture(np.zeros((2, 2, 3), np.uint8), time.monotonic())


@pytest.mark.parametrize("rates", [(0, 30), (30, 0), (0, 0, 30, 30)])
def test_views_that_hang_do_not_slow_the_others(rates, monkeypatch):
    monkeypatch.setattr("egocap.view.feeds._PATIENCE_S", 0.5)
    instants = list(LiveFeed([Paced(rate) for rate in rates], 2.0))
    assert len(instants) > 25
    for view, rate in enumerate(rates):
        assert all((i.images[view] is None) == (rate == 0) for i in instants[1:])


def test_what_is_no_source_is_named(tmp_path):
    (tmp_path / "x.avi").write_bytes(b"no video")
    with pytest.raises(InputError, match=r"x\.avi"):
        Source(str(tmp_path / "x.avi"))


def test_files_give_every_frame_at_its_own_time_and_again(tmp_path):
    made = make_motion(frames=60)
    names = [video(tmp_path / f"{side}.avi", 20, fps=25.0) for side in ("left", "right")]
    runs = []
    for _ in range(2):
        detector = Slow(made, 0.02)  # slower than the clips play would still take every frame
        tracker = OnlineTracker(made.rig, made.person, LIVE)
        poses = []
        report = follow_live(
            RecordedFeed(names), detector, tracker, lambda pose, _, poses=poses: poses.append(pose)
        )
        assert detector.calls == [[True, True]] * 20 and report.skipped == report.missing == 0
        runs.append(poses)
    first, again = runs
    np.testing.assert_allclose([pose.time for pose in first], np.arange(20) / 25.0, atol=1e-6)
    np.testing.assert_array_equal([p.angles for p in first], [p.angles for p in again])


def test_views_of_files_are_paired_by_time(tmp_path):
    names = [video(tmp_path / "a.avi", 20, fps=20.0), video(tmp_path / "b.avi", 5, fps=10.0)]
    instants = list(RecordedFeed(names))
    assert [instant.images[1] is not None for instant in instants[:10]] == [True, False] * 5
    assert all(instant.images[1] is None for instant in instants[10:])
    for instant in instants[:10:2]:
        number = round(10 * instant.time)
        assert abs(float(instant.images[1].mean()) - 10 * number) < 4


def test_a_feed_stops_when_asked(tmp_path):
    names = [video(tmp_path / "a.avi", 20)]
    asked = iter([False] * 3 + [True])
    assert len(list(RecordedFeed(names, stopped=lambda: next(asked)))) == 3
    assert len(list(RecordedFeed(names, seconds=0.21))) == 7


def test_cameras_are_listed_by_their_devices(tmp_path):
    assert list_cameras(tmp_path) == []
    (tmp_path / "video99").mkdir()
    (tmp_path / "video99" / "name").write_text("Helmet Left\n")
    (found,) = list_cameras(tmp_path)
    assert (found.number, found.name, found.size) == (99, "Helmet Left", None)


class Camera:
    """A camera as OpenCV shows it, which takes some settings and not others."""

    def __init__(self, number):
        self.values = {3: 640.0, 4: 480.0}

    def isOpened(self):
        return True

    def set(self, which, value):
        import cv2

        if which == cv2.CAP_PROP_EXPOSURE and value > 100:
            return False
        if value <= 1280:
            self.values[which] = value
        return True

    def get(self, which):
        return self.values.get(which, 30.0)

    def read(self):
        return True, np.zeros((int(self.values[4]), int(self.values[3]), 3), np.uint8)

    def release(self):
        pass


def test_cameras_take_settings_or_say_no(monkeypatch):
    monkeypatch.setattr("cv2.VideoCapture", Camera)
    (picture,) = first_pictures(["0"], CameraSettings(size=(1280, 1024), exposure=-5.0))
    assert picture.shape == (1024, 1280, 3)
    with pytest.raises(InputError, match=r"no pictures of \(4000, 3000\)"):
        first_pictures(["0"], CameraSettings(size=(4000, 3000)))
    with pytest.raises(InputError, match="no exposure of 500"):
        first_pictures(["0"], CameraSettings(exposure=500.0))
