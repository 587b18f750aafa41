from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from egocap.errors import FileError
from egocap_sim.motion.clips import bvh
from egocap_sim.motion.clips.bvh import parse_bvh, pose, read_bvh

GOOD = """HIERARCHY
ROOT Hips
{
  OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Left Leg
  {
    OFFSET 10 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -40 0
    }
  }
  JOINT Tail {
    OFFSET 0 0 -5
    CHANNELS 6 Xposition Yposition Zposition Yrotation Xrotation Zrotation }
}
MOTION
Frames: 2
Frame Time: 0.01
1 2 3 10 20 30 40 50 60 0 0 -5 0 0 0
1 2 4 11 21 31 41 51 61 0 1 -5 0 90 0
"""


def parents(bvh) -> tuple[int, ...]:
    return tuple(j.parent for j in bvh.joints)


def test_reads_hierarchy_channels_and_frames() -> None:
    bvh = parse_bvh(GOOD)
    assert bvh.names == ("Hips", "Left Leg", "Tail")
    assert parents(bvh) == (-1, 0, 0)
    assert bvh.joints[1].end_site == (0.0, -40.0, 0.0)
    assert bvh.joints[2].channels[0] == (9, "Xposition")
    assert bvh.frames.shape == (2, 15)
    assert bvh.fps == pytest.approx(100.0)


def test_forward_kinematics_agrees_with_scipy() -> None:
    bvh = parse_bvh(GOOD)
    W, p = pose(parents(bvh), *bvh.local())
    hips = Rotation.from_euler("ZXY", [10, 20, 30], degrees=True)
    leg = hips * Rotation.from_euler("ZXY", [40, 50, 60], degrees=True)
    np.testing.assert_allclose(W[0, 0], hips.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(W[0, 1], leg.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(p[0, 0], [1, 92, 3], atol=1e-12)
    np.testing.assert_allclose(p[0, 1], [1, 92, 3] + hips.apply([10, 0, 0]), atol=1e-12)


def test_position_channels_of_a_joint_replace_its_offset() -> None:
    _, t = parse_bvh(GOOD).local()
    np.testing.assert_allclose(t[:, 2], [[0, 0, -5], [0, 1, -5]])


@pytest.mark.parametrize("order", ["".join(o) for o in itertools.permutations("XYZ")])
def test_every_euler_order(order: str) -> None:
    text = GOOD.replace(
        "3 Zrotation Xrotation Yrotation", "3 " + " ".join(f"{a}rotation" for a in order)
    )
    R, _ = parse_bvh(text).local()
    expected = Rotation.from_euler(order, [40, 50, 60], degrees=True).as_matrix()
    np.testing.assert_allclose(R[0, 1], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("HIERARCHY", "HIERARCHIE", 1, "HIERARCHY"),
        ("ROOT Hips", "JOINT Hips", 2, "no joints"),
        ("OFFSET 10 0 0", "OFFSET 10 0", 9, "finite number"),
        ("OFFSET 10 0 0", "OFFSET 10 0 nan", 8, "finite number"),
        ("CHANNELS 3 Zrotation", "CHANNELS 3 Wrotation", 9, "Xposition"),
        ("CHANNELS 3 Z", "CHANNELS 9 Z", 9, "0 to 6"),
        ("Xrotation Yrotation\n    End", "Xrotation Xrotation\n    End", 9, "twice"),
        ("JOINT Tail", "JOINT Hips", 15, "two joints"),
        ("MOTION\n", "", 19, "MOTION"),
        ("Frames: 2", "Frames: 3", 23, "3 frames"),
        ("Frames: 2", "Frames: 0", 20, "above 0"),
        ("Frames: 2", "Frames: 1.5", 20, "whole"),
        ("0.01", "0", 21, "above 0"),
        ("0.01", "-0.01", 21, "above 0"),
        ("0.01", "fast", 21, "above 0"),
        ("1 2 4 11", "1 2 inf 11", 23, "inf"),
        ("1 2 4 11", "1 2 x 11", 23, "'x'"),
        ("1 2 4 11", "1 2 1e9 11", 23, "plausible"),
        ("0.01", "7", 21, "1e-05 to 1"),
    ],
)
def test_defects_name_the_line(old: str, new: str, line: int, says: str) -> None:
    text = GOOD.replace(old, new, 1)
    assert text != GOOD
    with pytest.raises(FileError, match=r".") as e:
        parse_bvh(text, "my.bvh")
    assert "my.bvh" in str(e.value) and says in str(e.value)
    assert e.value.line == line


def many_joints(count: int) -> str:
    """A file of a root and so many joints without channels, each below the last."""
    joints = "".join(f"JOINT j{i} {{ OFFSET 0 1 0 CHANNELS 0\n" for i in range(count))
    return GOOD.replace("  JOINT Left", joints + "  JOINT Left").replace(
        "MOTION", "}" * count + "MOTION"
    )


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        (many_joints(60_000), 1005, "more joints (valid: at most 1,000)"),
        (many_joints(900).replace("Frames: 2", "Frames: 9999999"), 921,
         "9,999,999 frames of 903 joints (valid: at most 4,644 frames)"),
        (GOOD + "1 " * (1 << 19) + "\n", 24, "at most 1,048,576 characters"),
        (GOOD + "7\n", 24, "more values than 2 frames of 15 channels (valid: 30 values)"),
    ],
)  # fmt: skip
def test_files_beyond_the_limits_are_refused_at_the_line_that_passes_them(
    text: str, line: int, says: str
) -> None:
    with pytest.raises(FileError) as e:
        parse_bvh(text)
    assert says in str(e.value) and e.value.line == line


def test_a_file_of_too_many_lines_is_refused(monkeypatch) -> None:
    assert bvh.MOST_LINES == 4_194_304
    monkeypatch.setattr(bvh, "MOST_LINES", 1000)
    assert len(parse_bvh("\n" * (1000 - GOOD.count("\n")) + GOOD).frames) == 2
    with pytest.raises(FileError, match=r"more lines.*at most 1,000") as e:
        parse_bvh("\n" * 1000 + GOOD)
    assert e.value.line == 1001


def test_a_thousand_joints_are_read() -> None:
    assert len(parse_bvh(many_joints(997)).joints) == 1000


def test_missing_file_and_binary_rubbish(tmp_path) -> None:
    with pytest.raises(FileError, match="cannot be read"):
        read_bvh(tmp_path / "none.bvh")
    (tmp_path / "b.bvh").write_bytes(bytes(range(256)) * 9)
    with pytest.raises(FileError):
        read_bvh(tmp_path / "b.bvh")


@settings(max_examples=150, deadline=None)
@given(cut=st.integers(0, len(GOOD.rstrip()) - 1))
def test_a_truncated_file_is_an_error(cut: int) -> None:
    with pytest.raises(FileError):
        parse_bvh(GOOD[:cut])


@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_mutations_give_a_finite_motion_or_an_error(data: st.DataObject) -> None:
    words = GOOD.replace("\n", " \n ").split(" ")
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(words) - 1))
        words[at] = data.draw(
            st.sampled_from(["", "}", "{", "nan", "1e999", "JOINT", "End", "MOTION", "7", "\x00"])
            | st.text(max_size=6)
        )
    try:
        bvh = parse_bvh(" ".join(words))
    except FileError:
        return
    assert np.isfinite(bvh.frames).all() and bvh.frames.ndim == 2
    _, p = pose(parents(bvh), *bvh.local())
    assert p.shape == (len(bvh.frames), len(bvh.joints), 3)


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=200))
def test_any_text_is_an_error(text: str) -> None:
    with pytest.raises(FileError):
        parse_bvh(text)
