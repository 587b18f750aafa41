"""The printed board has its true size."""

import re
import zlib

import pytest

from egocap.boards.board import parse_board
from egocap.boards.sheet import print_board
from egocap.errors import InputError

POINT_M = 0.0254 / 72


def test_page_and_squares_have_their_true_size(tmp_path):
    path = tmp_path / "board.pdf"
    board = parse_board("checkerboard:4x3:0.03")
    assert print_board(board, path) == "A4"
    data = path.read_bytes()
    page = re.search(rb"/MediaBox \[ 0 0 ([0-9.]+) ([0-9.]+) \]", data)
    assert [float(v) * POINT_M for v in page.groups()] == pytest.approx([0.210, 0.297], abs=1e-4)
    streams = re.findall(rb"stream\r?\n(.*?)endstream", data, re.DOTALL)
    content = b"".join(inflated(s) for s in streams)
    rows = re.findall(rb"([-0-9.]+) ([-0-9.]+) l", content)
    first = re.findall(rb"([-0-9.]+) ([-0-9.]+) m\n([-0-9.]+) ([-0-9.]+) l", content)
    sides = [abs(float(c) - float(a)) * POINT_M for a, _, c, _ in first]
    assert rows and min(abs(s - 0.03) for s in sides) < 1e-5


def inflated(stream: bytes) -> bytes:
    try:
        return zlib.decompress(stream)
    except zlib.error:
        return b""


def test_large_boards_get_a_page_of_their_own(tmp_path):
    assert "own size" in print_board(parse_board("checkerboard:30x20:0.1"), tmp_path / "b.pdf")


def test_only_pdf(tmp_path):
    with pytest.raises(InputError, match=r"\.pdf"):
        print_board(parse_board("checkerboard:4x3:0.03"), tmp_path / "board.png")
