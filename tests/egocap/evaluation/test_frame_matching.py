"""Predictions on a sequence's frames and in the head frame, or a reason why not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.body.labels import MIRROR
from egocap.body.proportions import Proportions
from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError
from egocap.evaluation.frame_matching import (
    match_frames,
    require_plausible_size,
    to_head_frame,
    warn_of_other_readings,
)
from egocap.evaluation.predictions import Predictions
from egocap.geometry import inverse, transform
from tests.egocap.conftest import peak_below

RIG = load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml")
FRAMES = 20
TIMES = np.arange(FRAMES) / 30
TRUTH = Proportions.from_lengths(1.75).rest_joints + 0.02 * np.sin(
    np.arange(FRAMES)[:, None, None] + np.arange(54).reshape(18, 3)
)
VALID = np.ones((FRAMES, 18), bool)
HEADS = np.broadcast_to(np.eye(4), (FRAMES, 4, 4)).copy()
HEADS[:, :3, :3] = Rotation.from_rotvec(
    0.1 * np.arange(FRAMES)[:, None] * [0.0, 0.0, 1.0]
).as_matrix()
HEADS[:, :3, 3] = [2.0, 3.0, 1.6]


def predicted(**changes):
    given = Predictions(TRUTH, VALID, "head", "m", np.arange(FRAMES))
    return replace(given, **changes)


def test_frames_in_any_order_and_by_time():
    order = np.random.default_rng(0).permutation(FRAMES)
    for numbered in ({"frames": order}, {"frames": None, "times": TIMES[order] + 4e-4}):
        positions, valid = match_frames(predicted(positions=TRUTH[order], **numbered), TIMES)
        np.testing.assert_array_equal(positions, TRUTH)
        assert valid.all()


@pytest.mark.parametrize(
    ("rows", "changes", "message"),
    [
        ([0, 1, 2, 2, *range(4, 20)], {}, "repeated frames: 2"),
        ([*range(19), 20], {}, "no such frames in the sequence: 20 .*0 to 19"),
        ([*range(3), *range(6, 20)], {}, r"3 of 20 frames are missing: 3-5 .*--missing skip"),
        (range(20), {"frames": None, "times": TIMES + 0.01}, "20 times belong to no frame"),
        (range(20), {"frames": None, "times": np.repeat(TIMES[:10], 2)}, "repeated frames: 0-9"),
    ],
)
def test_frames_that_do_not_fit(rows, changes, message):
    rows = np.array(list(rows))
    count = len(rows)
    given = predicted(positions=TRUTH[:count], valid=VALID[:count], frames=rows)
    with pytest.raises(InputError, match=message):
        match_frames(replace(given, **changes), TIMES)


def test_missing_frames_may_be_skipped():
    rows = np.arange(0, FRAMES, 2)
    positions, valid = match_frames(
        predicted(positions=TRUTH[rows], valid=VALID[rows], frames=rows), TIMES, "skip"
    )
    assert valid[rows].all() and not valid[rows + 1].any()
    np.testing.assert_array_equal(positions[rows], TRUTH[rows])


def test_times_are_matched_in_memory_of_the_frames():
    times = np.arange(20_000) / 60.0
    given = Predictions(np.zeros((20_000, 18, 3), np.float32), np.ones((20_000, 18), bool), "head",
                        "m", times=times + 2e-4)  # fmt: skip
    with peak_below(50e6):
        match_frames(given, times)


def test_frames_of_reference():
    for frame, T in (("world", HEADS), ("camera:right", inverse(RIG.mounts[1].T_head_camera))):
        moved = transform(T, TRUTH)
        np.testing.assert_allclose(to_head_frame(moved, frame, RIG, HEADS), TRUTH, atol=1e-12)
    with pytest.raises(InputError, match="camera:left, camera:right"):
        to_head_frame(TRUTH, "camera:top", RIG, HEADS)


@pytest.mark.parametrize(("scale", "unit"), [(1000, "mm"), (100, "cm")])
def test_a_person_as_tall_as_a_mountain(scale, unit):
    with pytest.raises(InputError, match=f"stated unit is 'm' .*unit '{unit}'"):
        require_plausible_size(scale * TRUTH, VALID, TRUTH, "m")
    require_plausible_size(TRUTH, VALID, TRUTH, unit)


def test_a_flea_a_giant_and_a_poor_method():
    require_plausible_size(0.4 * TRUTH, VALID, TRUTH, "m")
    for scale in (0.15, 7.0):
        with pytest.raises(InputError, match="the person spans"):
            require_plausible_size(scale * TRUTH, VALID, TRUTH, "m")
    with pytest.raises(InputError, match=r"stated unit is 'mm' .*unit 'm'"):
        require_plausible_size(0.001 * TRUTH, VALID, TRUTH, "mm")
    only = VALID & (np.arange(18) < 6)
    require_plausible_size(np.where(only[..., None], TRUTH, 99.0), only, TRUTH, "m")


def test_another_reading_that_would_explain_the_error():
    assert warn_of_other_readings(TRUTH + 0.01, VALID, TRUTH, "head", RIG, HEADS) == []
    (world,) = warn_of_other_readings(transform(HEADS, TRUTH), VALID, TRUTH, "head", RIG, HEADS)
    assert "in 'world' they would be 0" in world
    (mirrored,) = warn_of_other_readings(TRUTH[:, list(MIRROR)], VALID, TRUTH, "head", RIG, HEADS)
    assert "left and right exchanged" in mirrored
    for axis, name in enumerate("xyz"):
        signs = np.where(np.arange(3) == axis, -1.0, 1.0)
        flipped = warn_of_other_readings(signs * TRUTH, VALID, TRUTH, "head", RIG, HEADS)[-1]
        assert f"the sign of {name} changed" in flipped and "would be 0 mm off" in flipped
