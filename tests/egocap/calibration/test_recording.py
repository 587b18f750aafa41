"""Pictures and frames of several cameras are matched by name, number or time."""

from fractions import Fraction

import av
import cv2
import numpy as np
import pytest

from egocap.calibration.recording import read_recording
from egocap.errors import InputError


def write_pictures(folder, names):
    folder.mkdir()
    for k, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full((12, 16), 10 * k, np.uint8))


@pytest.mark.parametrize(
    ("left", "right", "shared"),
    [
        (["1.png", "2.png", "10.png"], ["2.png", "10.png"], 2),
        (["left_01.png", "left_02.png"], ["right_02.png", "right_03.png"], 1),
        (["left_1.png", "left_2.png"], ["right_0001.png", "right_0002.png"], 2),
        (["left_1.png", "left_2.png", "x9.png"], ["right_1.png", "right_2.png", "x9.png"], 3),
        (["1.png", "2.png", "a_3.png"], ["1.png", "2.png", "b_3.png"], 2),
        (["a_1.png", "b_1.png"], ["a_1.png", "c_1.png"], 1),
        (["a.png"], ["b.png"], 0),
    ],
)
def test_pictures_are_matched_by_name_or_number(tmp_path, left, right, shared):
    write_pictures(tmp_path / "left", left)
    write_pictures(tmp_path / "right", right)
    views = read_recording([tmp_path / "left", tmp_path / "right"]).views
    assert len(views[0].pictures.keys() & views[1].pictures.keys()) == shared
    assert views[0].size == (16, 12) and views[0].name == "left"


def write_video(path, rate, greys):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=Fraction(rate))
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for grey in greys:
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), grey, np.uint8), "rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def test_frames_of_videos_are_matched_by_time(tmp_path):
    write_video(tmp_path / "left.mp4", 20, range(0, 200, 10))
    write_video(tmp_path / "right.mp4", 10, range(0, 200, 20))
    views = read_recording([tmp_path / "left.mp4", tmp_path / "right.mp4"]).views
    assert sorted(views[0].pictures) == list(range(20))
    assert sorted(views[1].pictures) == list(range(0, 20, 2))
    for i, picture in views[1].pictures.items():
        assert abs(int(picture.mean()) - int(views[0].pictures[i].mean())) < 4


def test_two_sources_of_the_same_name(tmp_path):
    write_pictures(tmp_path / "left", ["1.png"])
    with pytest.raises(InputError, match="different folders"):
        read_recording([tmp_path / "left", tmp_path / "left"])


def test_frames_of_videos_in_threes(tmp_path):
    for name in ("left", "right"):
        write_video(tmp_path / f"{name}.mp4", 20, np.arange(200))
    recording = read_recording([tmp_path / "left.mp4", tmp_path / "right.mp4"], in_threes=True)
    assert len(recording.times) <= 120 and recording.times[-1] > 9.0
    gaps = np.diff(recording.times)
    assert np.isclose(gaps, 0.05).sum() >= 2 * len(gaps) // 3
    assert recording.views[0].pictures.keys() == recording.views[1].pictures.keys()
