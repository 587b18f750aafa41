"""The colours of the sides can be told apart with colour vision deficiencies."""

import cv2
import numpy as np
import pytest

from egocap.body.side_colours import INK, LEFT, RIGHT, side_colour, side_hex

# Machado, Oliveira & Fernandes 2009, severity 1.0, on linear RGB
DEFICIENCIES = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                   [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                     [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                   [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


def lab(rgb, matrix):
    linear = (np.asarray(rgb, float) / 255.0) ** 2.2 @ np.asarray(matrix).T
    seen = np.clip(linear, 0, 1) ** (1 / 2.2)
    return cv2.cvtColor(seen.astype(np.float32)[None, None], cv2.COLOR_RGB2LAB)[0, 0]


@pytest.mark.parametrize("name", DEFICIENCIES)
def test_left_and_right_differ(name):
    left, right = (lab(colour, DEFICIENCIES[name]) for colour in (LEFT, RIGHT))
    assert np.linalg.norm(left - right) > 40  # CIE76; 2.3 is just noticeable


def test_names_of_both_conventions():
    assert side_colour("left_wrist") == side_colour("l_hand") == LEFT
    assert side_colour("right_foot") == side_colour("r_toe") == RIGHT
    assert side_hex("right_foot") == "#d55e00" and side_hex("neck") == "#{:02x}{:02x}{:02x}".format(
        *INK
    )
