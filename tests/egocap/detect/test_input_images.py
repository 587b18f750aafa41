"""Pictures of every kind become 8-bit RGB, or an error that says what is valid."""

import threading

import cv2
import numpy as np
import pytest

from egocap.data.sequence import Sequence
from egocap.detect.input_images import ahead, as_rgb, recorded_pictures
from egocap.errors import FileError, InputError

RNG = np.random.default_rng(0)


def test_grey_and_deep_pictures():
    grey = RNG.integers(0, 256, (6, 8), dtype=np.uint8)
    deep = grey.astype(np.uint16) << 8 | 77
    for picture in (grey, grey[..., None], deep, deep[..., None], np.repeat(deep[..., None], 3, 2)):
        made = as_rgb(picture)
        assert made.shape == (6, 8, 3) and made.dtype == np.uint8
        assert (made == grey[..., None]).all()
    colour = RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    assert as_rgb(colour) is colour


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((4, 4, 3)), np.zeros((4, 4, 3), np.int32), np.zeros((4, 4, 4), np.uint8),
        np.zeros((0, 4, 3), np.uint8), np.zeros(5, np.uint8), np.zeros((2, 4, 4, 3), np.uint8),
    ],
)  # fmt: skip
def test_other_pictures_are_refused(picture):
    with pytest.raises(InputError, match="uint8 or uint16"):
        as_rgb(picture)


def test_recorded_pictures_are_the_sequences(tiny_sequence):
    sequence = Sequence(tiny_sequence)
    for index in (0, 6):
        pairs = zip(recorded_pictures(sequence, index), sequence.frame(index).images, strict=True)
        assert all(np.array_equal(a, b) for a, b in pairs)


@pytest.mark.parametrize(
    ("kind", "picture", "shape"),
    [
        ("jpg", np.full((1024, 1280, 3), 90, np.uint8), (512, 640, 3)),
        ("jpg", np.full((1024, 1280), 90, np.uint8), (512, 640, 3)),
        ("png", np.full((512, 640), 90 << 8, np.uint16), (512, 640, 3)),
    ],
)
def test_large_grey_and_deep_files(monkeypatch, tiny_sequence, kind, picture, shape):
    sequence = Sequence(tiny_sequence)
    _, data = cv2.imencode(f".{kind}", picture)
    monkeypatch.setattr(Sequence, "files", lambda *_: {f"left.{kind}": (0, 1)})
    monkeypatch.setattr(Sequence, "read", lambda *_: data.tobytes())
    size = picture.shape[1], picture.shape[0]
    monkeypatch.setattr(sequence, "rig", sequence.rig.resized(*size))
    left, right = recorded_pictures(sequence, 0)
    assert left is not None and left.shape == shape and left.dtype == np.uint8
    assert abs(int(left.mean()) - 90) <= 1
    assert right is None


@pytest.mark.parametrize("size", [(1281, 1023), (5312, 2988), (1280, 1023), (1280, 1024)])
def test_pixels_of_reduced_pictures_are_where_the_resized_camera_has_them(
    monkeypatch, tiny_sequence, size
):
    width, height = size
    middle = np.array([0.9 * width, 0.9 * height])
    v, u = np.mgrid[:height, :width]
    spread = 2.0 * ((u - middle[0]) ** 2 + (v - middle[1]) ** 2) / (0.05 * width) ** 2
    _, data = cv2.imencode(".jpg", (250 * np.exp(-spread)).astype(np.uint8))
    sequence = Sequence(tiny_sequence)
    monkeypatch.setattr(Sequence, "files", lambda *_: {"left.jpg": (0, 1)})
    monkeypatch.setattr(Sequence, "read", lambda *_: data.tobytes())
    monkeypatch.setattr(sequence, "rig", sequence.rig.resized(*size))
    picture = recorded_pictures(sequence, 0)[0]
    assert picture is not None
    grey = np.where(picture[..., 0] > 20, picture[..., 0], 0).astype(float)
    v, u = np.mgrid[: grey.shape[0], : grey.shape[1]]
    found = np.array([(u * grey).sum(), (v * grey).sum()]) / grey.sum()
    scale = np.array(size) / (grey.shape[1], grey.shape[0])
    np.testing.assert_allclose((found + 0.5) * scale - 0.5, middle, atol=0.1 * scale[0])


def test_damaged_file_names_the_frame(monkeypatch, tiny_sequence):
    monkeypatch.setattr(Sequence, "read", lambda *_: b"no picture")
    with pytest.raises(FileError, match=r"frame 3.*left.* damaged"):
        recorded_pictures(Sequence(tiny_sequence), 3)


def test_ahead_keeps_order_and_distance():
    begun: list[int] = []
    made = ahead(iter(range(20)), lambda job: begun.append(job) or job, count=2)
    for expected in range(20):
        assert next(made) == expected
        assert len(begun) <= expected + 3
    assert next(made, None) is None


def test_ahead_hands_errors_on_and_stops():
    def make(job):
        if job == 2:
            raise ValueError("two")
        return job

    before = threading.active_count()
    made = ahead(iter(range(9)), make)
    assert [next(made), next(made)] == [0, 1]
    with pytest.raises(ValueError, match="two"):
        next(made)
    assert threading.active_count() == before
