"""Proportions: construction, sanity, and body.json with everything that can be wrong with it."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.body.labels import LABEL_INDEX
from egocap.body.proportions import Proportions
from egocap.body.skeleton import POINT_INDEX, POINT_PARENTS, POINTS
from egocap.errors import FileError, InputError
from tests.egocap.conftest import rewritten

PERSON = Proportions.from_lengths(1.75)


@pytest.fixture
def body_file(tmp_path):
    path = tmp_path / "body.json"
    PERSON.save(path)
    return path


def test_round_trip_is_exact(body_file):
    assert np.array_equal(Proportions.load(body_file).offsets, PERSON.offsets)


def test_average_person_has_winters_segments():
    lengths = PERSON.bone_lengths
    assert lengths["left_elbow"] == pytest.approx(0.186 * 1.75)
    assert lengths["right_knee"] == pytest.approx(0.245 * 1.75)
    stature = PERSON.rest_joints[LABEL_INDEX["neck"], 2] - PERSON.rest_joints[:, 2].min()
    assert 0.78 < stature / 1.75 < 0.87  # cervicale height is 0.82 of stature


def test_measured_lengths_replace_average_ones():
    person = Proportions.from_lengths(1.75, elbow=0.30, lower_spine=0.35)
    assert person.bone_lengths["left_elbow"] == pytest.approx(0.30)
    assert person.bone_lengths["right_elbow"] == pytest.approx(0.30)
    assert person.bone_lengths["lower_spine"] == pytest.approx(0.35)
    with pytest.raises(InputError, match="no bone 'tail'"):
        Proportions.from_lengths(1.75, tail=0.3)


def test_measured_rest_joints_are_straightened_by_length():
    where = np.zeros((len(POINTS), 3))
    for i, parent in enumerate(POINT_PARENTS):
        where[i] = PERSON.offsets[i] + (where[parent] if parent >= 0 else 0)
    spread = {name: row.copy() for name, row in zip(POINTS, where, strict=True)}
    arm = PERSON.bone_lengths["left_elbow"]
    moved = (
        spread["left_shoulder"] + [0, arm * np.sin(0.7), -arm * np.cos(0.7)] - spread["left_elbow"]
    )
    for name in ("left_elbow", "left_wrist", "left_hand"):
        spread[name] += moved
    assert np.allclose(Proportions.from_rest_joints(spread).offsets, PERSON.offsets)
    del spread["neck"]
    with pytest.raises(InputError, match="neck"):
        Proportions.from_rest_joints(spread)


def test_mirroring_twice_changes_nothing():
    offsets = PERSON.offsets + 0.01 * np.random.default_rng(0).normal(size=(22, 3))
    person = Proportions(offsets)
    assert np.allclose(person.mirrored.mirrored.offsets, offsets)
    row = person.mirrored.offsets[POINT_INDEX["right_foot"]]
    assert np.allclose(row, person.offsets[POINT_INDEX["left_foot"]] * [1, -1, 1])


def test_offsets_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        PERSON.offsets[0] = 1


@pytest.mark.parametrize("length", [0.0, 2.0, np.nan])
def test_impossible_bones_are_refused(length):
    offsets = PERSON.offsets.copy()
    offsets[POINT_INDEX["left_knee"]] = (0, 0, -length)
    with pytest.raises(InputError, match="left_knee"):
        Proportions(offsets)


@pytest.mark.parametrize("height", [5.0, 0.2, float("nan")])
def test_impossible_heights_are_refused(height):
    with pytest.raises(InputError, match="height"):
        Proportions.from_lengths(height)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d["offsets"].pop("left_hip"), "left_hip"),
        (lambda d: d["offsets"].update(tail=[0, 0, 0]), "tail"),
        (lambda d: d["offsets"].update(neck=[0, 0]), "neck"),
        (lambda d: d["offsets"].update(neck=[0, 0, "far"]), "neck"),
        (lambda d: d["offsets"].update(neck=[0, 0, "0.1"]), "neck"),
        (lambda d: d["offsets"].update(left_knee=[0, 0, -3.0]), "left_knee"),
        (lambda d: d["offsets"].update(left_knee=[0, 0, float("nan")]), "left_knee"),
        (lambda d: d.update(units="cm"), "units"),
        (lambda d: d.update(schema_version=99), "newer"),
        (lambda d: d.update(colour="red"), "colour"),
        (lambda d: d.pop("kind"), "kind"),
    ],
)
def test_bad_files_name_the_key(body_file, change, says):
    with pytest.raises(FileError, match=says) as error:
        Proportions.load(rewritten(body_file, change))
    assert str(body_file) in str(error.value)


def test_missing_and_damaged_files(tmp_path, body_file):
    with pytest.raises(FileError, match="no such file"):
        Proportions.load(tmp_path / "none.json")
    body_file.write_text(body_file.read_text()[:100])
    with pytest.raises(FileError, match="JSON"):
        Proportions.load(body_file)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4)
    ),
    max_leaves=10,
)


@settings(deadline=None, max_examples=50)
@given(key=st.sampled_from(["kind", "schema_version", "units", "offsets"]), value=JSON)
def test_any_value_loads_or_is_a_file_error(tmp_path_factory, key, value):
    path = tmp_path_factory.mktemp("body") / "body.json"
    PERSON.save(path)
    rewritten(path, lambda data: data.update({key: value}))
    with contextlib.suppress(FileError):
        Proportions.load(path)
