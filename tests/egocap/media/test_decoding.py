"""Decoding: the size is read from the header, and damage is told from excess."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from egocap.errors import FileError
from egocap.media.decoding import decode
from tests.egocap.conftest import peak_below

IMAGE = np.random.default_rng(0).integers(0, 255, (12, 20, 3), np.uint8)


def png(width: int, height: int) -> bytes:
    """A PNG of this size, whose pixels are missing."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = (header, b"IDAT" + zlib.compress(bytes(1000)), b"IEND")
    body = (struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tiff", ".ppm"])
def test_lossless_formats_come_back(suffix):
    data = cv2.imencode(suffix, IMAGE)[1].tobytes()
    np.testing.assert_array_equal(decode(data, cv2.IMREAD_COLOR, "a.png"), IMAGE)


def test_large_images_are_refused_before_they_are_allocated():
    for width, height in ((32_000, 32_000), (8193, 8192), (8192, 8193)):
        refused = pytest.raises(FileError, match=r"a.png: .*at most 67108864")
        with peak_below(1 << 22), refused:
            decode(png(width, height), cv2.IMREAD_COLOR, "a.png")


@pytest.mark.parametrize("data", [b"", b"no image", png(0, 5), cv2.imencode(".png", IMAGE)[1][:40]])
def test_damaged_files_give_none(data):
    assert decode(bytes(data), cv2.IMREAD_COLOR, "a.png") is None
