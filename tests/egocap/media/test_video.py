"""Videos: times are the container's, pictures those that were encoded."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from egocap.errors import FileError
from egocap.media.video import open_video

SIZE = (64, 48)


def picture(number: int) -> np.ndarray:
    """Grey levels that say which frame it is, brighter on the left."""
    image = np.full((SIZE[1], SIZE[0], 3), 20 + 7 * number, np.uint8)
    image[:, : SIZE[0] // 2] += 30
    return image


def noisy(number: int) -> np.ndarray:
    """A picture whose size in the file is that of its detail."""
    noise = np.random.default_rng(1).integers(0, 255, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
    return np.roll(noise, number, 1)


def write_video(path: Path, ticks, codec="libx264", rotation=0, options=None, clock=90_000):
    """A video whose frames are shown at ticks of a clock."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, options=options or {})
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = Fraction(1, clock)
        if rotation:
            stream.set_display_rotation(rotation)
        for number, tick in enumerate(ticks):
            frame = av.VideoFrame.from_ndarray(picture(number), format="rgb24")
            frame.pts, frame.time_base = tick, Fraction(1, clock)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


UNEVEN = [0, 3003, 6006, 12012, 15015, 18500, 21021, 24024]


@pytest.mark.parametrize("name, codec", [
    ("a.mp4", "libx264"), ("a.mkv", "libx264"), ("a.mov", "libx265"), ("a.mp4", "libx265"),
])  # fmt: skip
def test_times_are_the_containers_and_pictures_in_their_order(tmp_path, name, codec):
    video = open_video(write_video(tmp_path / name, UNEVEN, codec))
    tolerance = 0.51e-3 if name.endswith("mkv") else 1e-5  # Matroska counts milliseconds
    np.testing.assert_allclose(np.diff(video.times), np.diff(UNEVEN) / 90_000, atol=2 * tolerance)
    found = list(video.frames())
    np.testing.assert_allclose([time for time, _ in found], video.times, atol=1e-6)
    for number, (_, image) in enumerate(found):
        assert image.shape == (SIZE[1], SIZE[0], 3)
        assert abs(image[:, 40:].mean() - picture(number)[:, 40:].mean()) < 4


@pytest.mark.parametrize("name, codec", [("a.avi", "mjpeg"), ("a.avi", "libx264")])
def test_avi_has_one_time_a_frame(tmp_path, name, codec):
    video = open_video(write_video(tmp_path / name, range(8), codec, clock=30))
    np.testing.assert_allclose(np.diff(video.times), 1 / 30, atol=1e-6)
    assert len(list(video.frames())) == 8


def test_a_frame_is_found_from_anywhere(tmp_path):
    ticks = [3003 * i for i in range(25)]
    path = write_video(tmp_path / "a.mp4", ticks, options={"g": "10", "bf": "3"})
    video = open_video(path)
    for number in (3, 4, 22, 5, 5, 0, 24):
        image = video.image(number)
        assert image is not None and abs(image[:, 40:].mean() - picture(number)[0, 40, 0]) < 4


OPEN_GOP = {"g": "10", "bf": "3", "x264-params": "open-gop=1"}


@pytest.mark.parametrize("name, options", [
    ("a.ts", {"g": "15", "bf": "2"}), ("a.ts", OPEN_GOP), ("a.mp4", OPEN_GOP),
])  # fmt: skip
def test_every_frame_of_a_transport_stream_or_open_gop_is_found_by_a_jump(tmp_path, name, options):
    path = write_video(tmp_path / name, [3003 * i for i in range(20)], options=options)
    in_order = [image for _, image in open_video(path).frames()]
    assert len(in_order) == len(open_video(path).times) == 20
    for number, expected in enumerate(in_order):
        assert abs(expected[:, 40:].mean() - picture(number)[0, 40, 0]) < 4
        np.testing.assert_array_equal(open_video(path).image(number), expected)


@pytest.mark.parametrize("name", ["a.mpg", "a.vob"])
def test_every_frame_of_a_program_stream_is_found_by_a_jump(tmp_path, name, monkeypatch):
    monkeypatch.setitem(globals(), "picture", noisy)
    codec = {"a.mpg": "mpeg1video", "a.vob": "mpeg2video"}[name]
    path = write_video(tmp_path / name, [i + 300 for i in range(40)], codec, clock=30)
    in_order = [image for _, image in open_video(path).frames()]
    assert len(in_order) == len(open_video(path).times) == 40
    for number, expected in enumerate(in_order):
        np.testing.assert_array_equal(open_video(path).image(number), expected)


@pytest.mark.parametrize("name, codec", [("a.mpg", "mpeg1video"), ("a.ts", "libx264")])
@pytest.mark.parametrize("first, second", [(0, 0), (0, 15), (3000, 0)])
def test_files_joined_byte_by_byte_are_refused(tmp_path, name, codec, first, second):
    """Their second clock begins again: at once, within the first's, or as if that ran over."""
    parts = [write_video(tmp_path / f"{i}{name}", range(start, start + 30), codec, clock=30)
             for i, start in enumerate((first, second))]  # fmt: skip
    joined = tmp_path / name
    joined.write_bytes(b"".join(path.read_bytes() for path in parts))
    for path in parts:
        assert len(open_video(path).times) == 30
    with pytest.raises(FileError, match=rf"{name}: its clock jumps from .*ffmpeg -i FILE"):
        _ = open_video(joined).times


def test_avi_with_b_frames_is_in_the_order_of_the_pictures(tmp_path):
    path = write_video(tmp_path / "a.avi", range(25), options={"g": "10", "bf": "3"}, clock=30)
    video = open_video(path)
    found = list(video.frames())
    np.testing.assert_allclose([time for time, _ in found], video.times, atol=1e-6)
    assert len(found) == 25 and (np.diff(video.times) > 0).all()
    for number in (*range(25), 12, 3):
        shown = picture(number)[0, 40, 0]
        assert abs(found[number][1][:, 40:].mean() - shown) < 4
        assert abs(video.image(number)[:, 40:].mean() - shown) < 4


def test_a_raw_stream_without_times_is_refused(tmp_path):
    path = write_video(tmp_path / "a.h264", [3003 * i for i in range(10)])
    with pytest.raises(FileError, match=r"a\.h264: does not state the times of its pictures"):
        open_video(path)


def display_matrix(path):
    """Where the file says that right and down of a stored picture are shown: (2, 2), x and y.

    Source: ISO/IEC 14496-12, track header box: a, b, u, c, d, v, x, y, w.
    """
    data = path.read_bytes()
    at = data.index(b"tkhd") + 4 + 4 + 20 + 8 + 8  # version, times and number, reserved, layers
    a, b, _, c, d = np.frombuffer(data[at : at + 20], ">i4") / 65536
    return np.array([[a, b], [c, d]])


@pytest.mark.parametrize("rotation", [90, 180, -90])
def test_the_rotation_flag_is_applied(tmp_path, rotation):
    path = write_video(tmp_path / "a.mp4", [0, 3003], rotation=rotation)
    (right_x, right_y), (down_x, down_y) = display_matrix(path).round().astype(int)
    _, image = next(open_video(path).frames())
    stored = picture(0)
    height, width = image.shape[:2]
    assert (width, height) == (SIZE if right_x else SIZE[::-1])
    for x, y in ((5, 7), (50, 40)):
        shown_x = (right_x * x + down_x * y) % width if right_x + down_x > 0 else (
            width - 1 + right_x * x + down_x * y)  # fmt: skip
        shown_y = (right_y * x + down_y * y) % height if right_y + down_y > 0 else (
            height - 1 + right_y * x + down_y * y)  # fmt: skip
        assert abs(int(image[shown_y, shown_x, 0]) - int(stored[y, x, 0])) < 5


def test_a_damaged_time_is_that_of_one_frame(tmp_path):
    path = write_video(tmp_path / "a.ts", range(30), "mpeg2video", clock=30)
    stated = open_video(path).times
    data = bytearray(path.read_bytes())
    headers = [i for i in range(len(data)) if data[i : i + 4] == b"\0\0\1\xe0"]
    for at in range(headers[14] + 9, headers[14] + 9 + data[headers[14] + 8], 5):  # PTS, DTS
        data[at + 1] ^= 0x10  # bit 26 of 33 of a clock of 90 kHz
    path.write_bytes(data)
    damaged = open_video(path).times
    assert len(damaged) == 30 and len(np.setdiff1d(damaged, stated)) == 1


def test_a_damaged_stretch_loses_its_frames_alone(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "picture", noisy)
    path = write_video(
        tmp_path / "a.mkv", [3003 * i for i in range(30)], options={"g": "5", "bf": "0"}
    )
    data = bytearray(path.read_bytes())
    middle = slice(int(0.45 * len(data)), int(0.5 * len(data)))
    data[middle] = np.random.default_rng(0).bytes(middle.stop - middle.start)
    path.write_bytes(data)
    found = [time for time, _ in open_video(path).frames()]
    assert 10 <= len(found) < 30 and found[0] == 0.0 and found[-1] > 0.9


@pytest.mark.parametrize("content", [b"", b"not a video at all" * 100])
def test_what_is_no_video_is_said(tmp_path, content):
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    with pytest.raises(FileError, match="cannot be read as a video"):
        open_video(path)


def test_a_file_that_breaks_off_gives_what_is_there(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "picture", noisy)
    path = write_video(tmp_path / "a.mkv", [3003 * i for i in range(30)], options={"g": "5"})
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert 5 < len(list(open_video(path).frames())) < 30
