"""Folders of pictures: order and times from the names, 8-bit RGB from any kind of file."""

import cv2
import numpy as np
import pytest

from egocap.errors import FileError
from egocap.media.pictures import PictureOptions, open_pictures

RNG = np.random.default_rng(4)
THIRTY = PictureOptions(fps=30.0)


def smooth(height=48, width=64):
    """A picture without fine detail, RGB."""
    coarse = RNG.integers(0, 255, (4, 5, 3)).astype(np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def test_names_give_order_and_times(tmp_path):
    for number in (8, 9, 10, 12):
        cv2.imwrite(str(tmp_path / f"cam1_{number}.png"), np.full((6, 8, 3), number, np.uint8))
    (tmp_path / "._cam1_8.png").write_bytes(b"of macOS, beside every file of another disk")
    folder = open_pictures(tmp_path, THIRTY)
    np.testing.assert_allclose(folder.times, np.array([0, 1, 2, 4]) / 30.0)
    assert [image[0, 0, 0] for _, image in folder.frames()] == [8, 9, 10, 12]
    assert folder.size == (8, 6)


def test_names_may_be_times(tmp_path):
    stamps = [1403636579763555584, 1403636579813555456]
    for stamp in stamps:
        cv2.imwrite(str(tmp_path / f"{stamp}.png"), np.zeros((6, 8), np.uint8))
    times = open_pictures(tmp_path, PictureOptions(stamp="ns")).times
    assert abs((times[1] - times[0]) - 0.049999872) < 1e-6


@pytest.mark.parametrize("kind", ["colour", "grey", "deep", "deep grey", "12 bits", "alpha"])
def test_any_depth_and_colour_becomes_rgb(tmp_path, kind):
    image = smooth()
    stored = image[..., ::-1]
    if "grey" in kind:
        image = np.repeat(image[..., :1], 3, 2)
        stored = image[..., 0]
    if kind.startswith("deep"):
        stored = stored.astype(np.uint16) * 257
    if kind == "12 bits":
        stored = stored.astype(np.uint16) << 4
    if kind == "alpha":
        stored = np.dstack([stored, np.full(stored.shape[:2], 9, np.uint8)])
    cv2.imwrite(str(tmp_path / "1.png"), stored)
    bits = 12 if kind == "12 bits" else 16
    (found,) = (i for _, i in open_pictures(tmp_path, PictureOptions(fps=30, bits=bits)).frames())
    np.testing.assert_array_equal(found, image)


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_mosaics_are_restored(tmp_path, pattern):
    image = smooth()
    mosaic = np.zeros(image.shape[:2], np.uint8)
    for place, letter in enumerate(pattern):
        rows, columns = slice(place // 2, None, 2), slice(place % 2, None, 2)
        mosaic[rows, columns] = image[rows, columns, "RGB".index(letter)]
    cv2.imwrite(str(tmp_path / "1.png"), mosaic)
    options = PictureOptions(fps=30.0, bayer=pattern)
    (found,) = (i for _, i in open_pictures(tmp_path, options).frames())
    assert np.abs(found.astype(int) - image)[2:-2, 2:-2].mean() < 4


@pytest.mark.parametrize("names, message", [
    (["a.png"], "its name holds no number"), ([], "holds no pictures"),
    (["a1.png", "b1.png"], "has the number of a1.png"),
])  # fmt: skip
def test_folders_without_an_order_are_refused(tmp_path, names, message):
    for name in names:
        cv2.imwrite(str(tmp_path / name), np.zeros((6, 8), np.uint8))
    with pytest.raises(FileError, match=message):
        open_pictures(tmp_path, THIRTY)


def test_a_rate_is_asked_for(tmp_path):
    cv2.imwrite(str(tmp_path / "1.png"), np.zeros((6, 8), np.uint8))
    with pytest.raises(FileError, match="--fps"):
        open_pictures(tmp_path)


def test_damaged_and_odd_pictures(tmp_path):
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((6, 8), number, np.uint8))
    (tmp_path / "1.png").write_bytes(b"broken")
    folder = open_pictures(tmp_path, THIRTY)
    assert folder.image(1) is None and [round(30 * t) for t, _ in folder.frames()] == [0, 2]
    cv2.imwrite(str(tmp_path / "2.png"), np.zeros((8, 8), np.uint8))
    with pytest.raises(FileError, match="is 8 x 8"):
        folder.image(2)
