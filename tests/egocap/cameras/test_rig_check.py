"""Each mistake in a rig file has its line; the shipped rigs have none."""

from pathlib import Path

import pytest

from egocap.cameras.rig_check import check_rig
from egocap.cameras.rig_files import load_rig, parse_rig

LENS = {"model": "equidistant", "width": 640, "height": 512, "fov": 180.0}
STEREO = {"baseline": 0.3, "forward": 0.3, "up": 0.1, "pitch": 85}


def stereo(lens: dict | None = None, **changes: object):
    return parse_rig({"name": "r", "lens": LENS | (lens or {}), "stereo": STEREO | changes}, "r")


def cameras(*entries: dict):
    whole = [{"pitch": 85} | entry for entry in entries]
    return parse_rig({"name": "r", "lens": LENS, "cameras": whole}, "r")


def test_shipped_rigs_are_clean():
    for path in (Path(__file__).parents[3] / "scenes" / "rigs").glob("*.toml"):
        assert check_rig(load_rig(path)) == [], path


@pytest.mark.parametrize(
    ("rig", "message"),
    [
        (stereo(pitch=-90), "'left' looks 90 degrees up"),
        (stereo(baseline=1.8), "are 1.80 m apart"),
        (stereo(baseline=0.004), "4 mm apart: no depth"),
        (stereo(forward=1.5), "1.51 m from the skull base"),
        (stereo(baseline=0.05, forward=0.02, up=0.06), "'left' is inside the head"),
        (stereo({"fov": 60}), "sees 60 degrees"),
        (stereo({"centre": [600.0, 250.0]}), r"optical axis at \(600, 250\)"),
        (stereo(pitch=-15), "feet of a standing wearer"),
        (cameras({"name": "left", "position": [0.3, -0.15, 0.1]},
                 {"name": "right", "position": [0.3, 0.15, 0.1]}), "the pair is swapped"),
        (cameras({"name": "left", "position": [0.3, 0.15, 0.1], "roll": 180},
                 {"name": "right", "position": [0.3, -0.15, 0.1]}), "turned against each other"),
    ],
)  # fmt: skip
def test_a_mistake_is_told(rig, message):
    import re

    assert any(re.search(message, line) for line in check_rig(rig)), check_rig(rig)
