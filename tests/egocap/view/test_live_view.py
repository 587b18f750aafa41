"""Films keep time and are whole or not there; a browser gets the newest picture."""

import http.client
import urllib.error
import urllib.parse
import urllib.request

import cv2
import numpy as np
import pytest

from egocap.body.skeleton import forward
from egocap.errors import InputError, MachineError
from egocap.track.online import PoseEstimate
from egocap.view.live_page import MOST_VIEWERS, PictureStream
from egocap.view.live_view import PoseDisplay
from egocap.view.video import VideoFile
from tests.egocap.conftest import make_motion


def grey(value):
    return np.full((48, 64, 3), value, np.uint8)


def frames(path):
    video = cv2.VideoCapture(str(path))
    found = []
    while (read := video.read())[0]:
        found.append(read[1])
    return found


def test_a_film_keeps_time(tmp_path):
    with VideoFile(tmp_path / "deep" / "f.mp4", fps=10.0) as film:
        for at, value in ((0.0, 40), (0.02, 250), (0.5, 200), (0.61, 90)):
            film.add(grey(value), at)
    values = [int(f.mean()) for f in frames(tmp_path / "deep" / "f.mp4")]
    assert np.allclose(values, [40, 200, 200, 200, 200, 200, 90], atol=8)


def test_a_film_shows_every_picture_of_its_rate(tmp_path):
    times = np.arange(20) / 30.0
    for shifted in (times.round(3), times * 0.999, times + 0.01 * np.sin(np.arange(20))):
        with VideoFile(tmp_path / "f.mp4", fps=30.0) as film:
            for at, value in zip(shifted, range(20, 220, 10), strict=True):
                film.add(grey(value), at)
        values = [int(f.mean()) for f in frames(tmp_path / "f.mp4")]
        assert np.allclose(values, range(20, 220, 10), atol=4)


def test_a_film_that_fails_is_not_there(tmp_path):
    with pytest.raises(ZeroDivisionError), VideoFile(tmp_path / "f.mp4") as film:
        film.add(grey(1))
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())
    with VideoFile(tmp_path / "empty.mp4"):
        pass
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"ends in \.mp4"):
        VideoFile(tmp_path / "f.avi")
    with pytest.raises(InputError, match="is a folder"):
        (tmp_path / "d.mp4").mkdir()
        VideoFile(tmp_path / "d.mp4")


@pytest.fixture
def stream():
    made = PictureStream(port=0)
    yield made
    made.close()


def test_a_page_shows_the_newest_picture(stream):
    with urllib.request.urlopen(stream.url, timeout=60) as page:
        assert b'src="stream"' in page.read()
    stream.show(grey(10))
    stream.show(grey(170))
    with urllib.request.urlopen(f"{stream.url}stream", timeout=60) as answer:
        assert "multipart/x-mixed-replace" in answer.headers["Content-Type"]
        assert answer.readline().startswith(b"--")
        answer.readline()
        size = int(answer.readline().split(b":")[1])
        answer.readline()
        picture = cv2.imdecode(np.frombuffer(answer.read(size), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (48, 64, 3) and abs(picture.mean() - 170) < 3
    with pytest.raises(urllib.error.HTTPError):
        urllib.request.urlopen(f"{stream.url}other", timeout=60)


def test_a_taken_port_is_named(stream):
    port = urllib.parse.urlsplit(stream.url).port
    with pytest.raises(MachineError, match=f"port {port}"):
        PictureStream(port)


def test_the_watcher_hands_on_pose_and_pictures(tmp_path, stream):
    made = make_motion(frames=3)
    with VideoFile(tmp_path / "f.mp4", fps=30.0) as film:
        watcher = PoseDisplay(made.rig, stream, film)
        for t in range(3):
            pose = PoseEstimate(5.0 + t / 30, made.angles[t], forward(made.person, made.angles[t]),
                            np.zeros((18, 3, 3)), np.ones(18), True)  # fmt: skip
            watcher(pose, [None, np.full((512, 640, 3), 60, np.uint8)])
    found = frames(tmp_path / "f.mp4")
    assert len(found) == 3 and found[0].shape == (360, 900 + 360, 3)
    assert found[0][:, 460:880].mean() > 40 > found[0][:, 20:440].mean()
    PoseDisplay(made.rig)(pose, [None, None])


def _status(stream, path, **headers):
    """Status of a request by path and headers."""
    place = urllib.parse.urlsplit(stream.url)
    connection = http.client.HTTPConnection(place.hostname, place.port, timeout=60)
    connection.request("GET", path, headers=headers)
    return connection.getresponse().status


def test_the_page_requires_the_token_and_the_loopback(stream):
    own = urllib.parse.urlsplit(stream.url).path
    assert len(own) > 20
    assert _status(stream, own) == 200 and _status(stream, own, Host="localhost:9000") == 200
    for path in ("/", "/stream", "/wrong/", own[:-2] + "/", f"{own}../stream", "/../../etc/passwd"):
        assert _status(stream, path) == 404
    for place in ("evil.example", "127.0.0.1.evil.example", ""):
        assert _status(stream, own, Host=place) == 403
    for origin in ("http://evil.example", "null"):
        assert _status(stream, own, Origin=origin) == 403


def test_two_pages_have_two_tokens(stream):
    other = PictureStream(port=0)
    try:
        mine = urllib.parse.urlsplit(stream.url).path
        assert mine != urllib.parse.urlsplit(other.url).path
        assert _status(other, mine) == 404
    finally:
        other.close()


def test_streams_are_bounded(stream):
    path = f"{urllib.parse.urlsplit(stream.url).path}stream"
    place = urllib.parse.urlsplit(stream.url)
    held = []
    for _ in range(MOST_VIEWERS):
        connection = http.client.HTTPConnection(place.hostname, place.port, timeout=60)
        connection.request("GET", path)
        assert connection.getresponse().status == 200
        held.append(connection)
    assert _status(stream, path) == 503
    for connection in held:
        connection.close()
