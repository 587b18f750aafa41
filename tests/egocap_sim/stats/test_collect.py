"""Counts against sequences whose content is known."""

import json
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.data.dataset import find_sequences
from egocap.data.sequence import Sequence
from egocap.data.truth import OUT_OF_VIEW, VISIBLE
from egocap.errors import FileError, InputError
from egocap_sim.stats.collect import Statistics, joint_bend
from egocap_sim.stats.page import render_page, summary


@pytest.fixture(scope="module")
def counted(tiny_sequence: Path) -> Statistics:
    statistics = Statistics()
    for _ in range(2):
        statistics.add(tiny_sequence)
    return statistics


def test_causes_add_up_and_are_those_of_the_truth(counted, tiny_sequence):
    truth = Sequence(tiny_sequence).truth
    frames = len(truth.time)
    assert counted.frames == 2 * frames and len(counted.persons) == 1
    for v, view in enumerate(("left", "right")):
        assert (counted.causes[view].sum(1) == 2 * frames).all()
        for cause in (VISIBLE, OUT_OF_VIEW):
            expected = (truth.visibility[:, v] == cause).sum(0) * 2
            assert np.array_equal(counted.causes[view][:, cause], expected)
        assert np.array_equal(counted.heat[view].sum((1, 2)), 2 * truth.in_view[:, v].sum(0))
    assert counted.visible == pytest.approx((truth.visibility == VISIBLE).mean((0, 1)))


def test_spread_is_the_standard_deviation_in_the_head_frame(counted, tiny_sequence):
    joints = Sequence(tiny_sequence).truth.joints_head
    expected = np.sqrt(((joints - joints.mean(0)) ** 2).sum(-1).mean(0))
    assert counted.spread_m == pytest.approx(expected, abs=1e-6)


def test_every_frame_is_in_every_histogram(counted):
    assert (counted.angles.sum(1) == counted.frames).all()
    assert counted.stance.sum() == counted.force.sum() == counted.frames
    assert counted.hands.sum((2, 3)).min() == counted.frames


def test_a_joint_position_falls_into_its_cell(counted, tiny_sequence):
    sequence = Sequence(tiny_sequence)
    j = LABEL_INDEX["left_foot"]
    camera = sequence.rig.cameras[0]
    mean = sequence.truth.joints_2d[:, 0, j].mean(0) + 0.5
    rows, columns = np.nonzero(counted.heat["left"][j])
    cells = np.average(np.stack([columns, rows], 1) + 0.5, axis=0)
    assert cells / (50, 40) == pytest.approx(mean / (camera.width, camera.height), abs=0.03)


@pytest.mark.parametrize("degrees", [0.0, 45.0, 90.0, 180.0])
def test_bends(degrees):
    a, b = np.array([[0.0, 0, 1]]), np.zeros((1, 3))
    way = np.array([[np.sin(np.radians(degrees)), 0, -np.cos(np.radians(degrees))]])
    assert np.degrees(joint_bend(a, b, b + 2 * way)) == pytest.approx([degrees], abs=1e-5)


def test_sequences_are_found_within_folders(tiny_sequence, tmp_path):
    assert find_sequences([tiny_sequence, tiny_sequence]) == [tiny_sequence]
    assert tiny_sequence in find_sequences([tiny_sequence.parent])
    with pytest.raises(InputError, match="holds no sequence"):
        find_sequences([tmp_path])
    with pytest.raises(FileError, match="no such folder"):
        find_sequences([tmp_path / "none"])


def test_dropped_images_are_counted_among_those_of_every_rig(counted):
    mixed = deepcopy(counted)  # half of the frames by another rig, with views of other names
    halves = {f"{rig} {view}": n / 2 for rig in "ab" for view, n in counted.causes.items()}
    mixed.causes, mixed.dropped = halves, counted.frames
    assert summary(mixed)["dropped_images"] == 50.0


def test_the_page_is_whole_and_needs_nothing_else(counted):
    page = render_page(counted)
    assert page.count("data:image/svg+xml;base64,") == 7
    assert "http" not in page.replace("http-equiv", "")
    assert all(label.replace("_", " ") in page for label in LABELS)
    numbers = summary(counted)
    assert json.loads(json.dumps(numbers)) == numbers
    shares = [sum(v for k, v in joint.items() if k not in ("seen_by_any", "spread_cm"))
              for joint in numbers["joints"].values()]  # fmt: skip
    assert shares == pytest.approx([100.0] * 18)
