"""Cleaned motion files are found again by their content, never stale, never half."""

import ast
from pathlib import Path

import numpy as np
import pytest

from egocap.errors import FileError
from egocap.geometry import matrix_to_quaternion
from egocap_sim.core.bodies import BODIES
from egocap_sim.motion.clips import clip_store, load
from egocap_sim.motion.clips.clip_store import stored_clip, stored_motion
from egocap_sim.motion.clips.load import load_clip, load_motion
from egocap_sim.motion.generators.registry import make_motion


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return _written(tmp_path / "motion.npz", "walk")


def _written(path, motion):
    clip = make_motion(motion, 2.0, np.random.default_rng(1))
    quaternions = matrix_to_quaternion(clip.rotations)
    np.savez(path, joints=np.array(BODIES), pos=clip.positions, quat=quaternions, fps=clip.fps)
    return path


def test_the_second_reading_is_the_first_without_its_work(file, monkeypatch):
    expected = load_clip(file)
    first = stored_clip(file)
    monkeypatch.setattr(load, "load_motion", None)
    for clip in (first, stored_clip(file)):
        assert (clip.name, clip.fps, clip.canonical) == (expected.name, expected.fps, True)
        np.testing.assert_array_equal(clip.positions, expected.positions)
        np.testing.assert_array_equal(clip.rotations, expected.rotations)


def test_raw_motion_and_report_are_kept(file):
    expected = load_motion(file)
    for motion in (stored_motion(file), stored_motion(file)):
        np.testing.assert_array_equal(motion.raw.rotations, expected.raw.rotations)
        assert motion.report == expected.report


def test_another_content_is_another_clip_and_damage_is_repaired(file, caplog):
    before = stored_clip(file)
    _written(file, "squat")
    assert abs(stored_clip(file).positions[30] - before.positions[30]).max() > 0.01
    for kept in (file.parent / "cache/egocap/clips").iterdir():
        kept.write_bytes(kept.read_bytes()[:100])
    np.testing.assert_array_equal(stored_clip(file).positions, load_clip(file).positions)
    assert "damaged" in caplog.text


def test_files_that_cannot_be_understood_stay_errors(file):
    file.write_bytes(b"nothing")
    for _ in range(2):
        with pytest.raises(FileError, match="motion"):
            stored_clip(file)
    with pytest.raises(FileError, match="missing"):
        stored_clip(file.with_name("missing.npz"))


def test_all_that_decides_what_is_read_is_fingerprinted():
    folder = Path(clip_store.__file__).parents[2]
    for name in clip_store.READERS:
        for node in ast.walk(ast.parse((folder / name).read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("egocap_sim."):
                used = node.module.removeprefix("egocap_sim.").replace(".", "/") + ".py"
                assert used in clip_store.READERS, f"{name} uses {used}"
