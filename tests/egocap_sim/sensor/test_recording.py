"""Sequences recorded through a faulty sensor: faults in the pictures, known in the truth."""

import hashlib
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from egocap.data.sequence import Sequence
from egocap.data.truth import SensorTruth
from egocap.errors import FileError
from egocap_sim.core.resources import builtin_file
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import Scene, load_scene, to_toml
from egocap_sim.verification.integrity import verify

FRAMES = 6
CUP = {"kind": "cup", "hand": "right"}


def scene(frames: int = FRAMES, start_s: float = 6.0, things=(), **sensor) -> Scene:
    data = load_scene(builtin_file("scene", "validation-walk")).model_dump(exclude_none=True)
    data["frames"], data["rig"]["size"], data["things"] = frames, (160, 128), things
    data["motion"]["start_s"] = start_s  # in full stride
    data["place"]["clear_radius"] = 2.5  # the same room for every part of the walk
    data["record"] |= {"shard_frames": 3, "image_format": "png"}
    if sensor:
        data["sensor"] = sensor
    return Scene.model_validate(data)


def record(folder: Path, **options) -> Sequence:
    generate(scene(**options), folder, workers=0)
    result = verify(folder)
    assert result.clean, result.problems
    return Sequence(folder)


@pytest.fixture(scope="module")
def perfect(tmp_path_factory) -> Sequence:
    return record(tmp_path_factory.mktemp("perfect") / "s")


@pytest.fixture(scope="module")
def late(tmp_path_factory) -> Sequence:
    """The right camera sees exactly one frame later than the left, and half of that."""
    return record(tmp_path_factory.mktemp("late") / "s", time_offset_s=1 / 30)


def test_a_sensor_without_faults_changes_no_picture_and_no_truth(perfect, tmp_path):
    clean = record(tmp_path / "clean", preset="clean", subframes=5)
    for name in ("truth.npz", "shard-00000.tar", "shard-00001.tar"):
        ours, theirs = (Path(s.folder / name).read_bytes() for s in (clean, perfect))
        assert hashlib.sha256(ours).digest() == hashlib.sha256(theirs).digest(), name
    assert clean.sensor is None and clean.true_rig == clean.rig


def test_a_camera_one_frame_late_shows_the_next_frame(perfect, late):
    """Rendered, not copied: the marker of time is the picture itself."""
    for t in range(FRAMES - 1):
        ours, next_ = late.frame(t).images[1].astype(int), perfect.frame(t + 1).images[1]
        own = perfect.frame(t).images[1]
        assert np.abs(ours - next_).mean() < 0.05
        assert np.abs(ours - own).mean() > 1.0
        assert np.array_equal(late.frame(t).images[0], perfect.frame(t).images[0])
        assert np.array_equal(late.mask(t, "right"), perfect.mask(t + 1, "right"))


def test_truth_of_a_late_camera_is_that_of_its_own_time(perfect, late):
    theirs, ours = perfect.truth, late.truth
    assert np.allclose(ours.joints_2d[:-1, 1], theirs.joints_2d[1:, 1], atol=1e-6)
    assert np.array_equal(ours.joints_2d[:, 0], theirs.joints_2d[:, 0]) or np.allclose(
        ours.joints_2d[:, 0], theirs.joints_2d[:, 0], atol=1e-9
    )
    assert np.array_equal(ours.joints_head, theirs.joints_head)  # the physics are the same
    assert np.array_equal(ours.visibility[:-1, 1], theirs.visibility[1:, 1])
    assert np.allclose(late.sensor.time[:, 1] - late.sensor.time[:, 0], 1 / 30)


def test_dropped_frames_repeat_the_last_picture_and_are_flagged(perfect, tmp_path):
    sequence = record(tmp_path / "dropped", drop_rate=0.6)
    dropped = sequence.sensor.dropped
    assert dropped.any() and not dropped[0].any()
    for t, v in np.ndindex(*dropped.shape):
        shown = sequence.sensor.source[t, v]
        assert np.array_equal(sequence.frame(t).images[v], perfect.frame(shown).images[v])
    assert np.array_equal(sequence.truth.joints_2d, perfect.truth.joints_2d)


def test_views_that_are_late_or_early_show_people_and_things_then(tmp_path):
    """In the last frame after the motion of the frames ends, in the first before it begins."""
    late = record(tmp_path / "late", things=[CUP], time_offset_s=2 / 30)
    longer = record(tmp_path / "longer", frames=FRAMES + 2, things=[CUP])
    early = record(tmp_path / "early", things=[CUP], time_offset_s=-1 / 30)
    sooner = record(tmp_path / "sooner", start_s=6.0 - 1 / 30, things=[CUP])
    for ours, t, theirs, same in ((late, FRAMES - 1, longer, FRAMES + 1), (early, 0, sooner, 0)):
        seen, right = ours.frame(t).images[1].astype(int), theirs.frame(same).images[1].astype(int)
        frozen = longer.frame(t).images[1].astype(int)
        assert np.abs(seen - right).mean() < 0.2 * np.abs(seen - frozen).mean()


def test_views_far_too_early_for_things_are_refused():
    with pytest.raises(ValueError, match=r"'time_offset_s' .* must be at least -0\.0333"):
        scene(things=[CUP], time_offset_s=-0.05)
    scene(time_offset_s=-0.05)


def test_labels_follow_the_rows_of_a_rolling_shutter(perfect, tmp_path):
    sequence = record(tmp_path / "rolling", readout_s=0.03, subframe_px=0.77)
    sensor, truth = sequence.sensor, sequence.truth
    assert len(np.unique(sensor.subframes)) > 1 and sensor.subframes.min() >= 1
    height = sequence.rig.cameras[0].height
    rows = np.clip(truth.joints_2d[..., 1], -0.5, height - 0.5)
    expected = sensor.time[..., None] + ((rows + 0.5) / height - 0.5) * 0.03
    assert np.abs(sensor.joint_time - expected).max() < 1e-5
    moved = np.linalg.norm(truth.joints_2d - perfect.truth.joints_2d, axis=-1)[truth.in_view]
    assert 0.1 < moved.max() < 5


def test_many_subframes_may_be_less_sharp(tmp_path):
    """Frames of few stay as they are; of many hardly change, and the truth not at all."""
    motion = {"shutter_s": 0.03, "subframe_px": 0.77}
    sharp = record(tmp_path / "sharp", **motion)
    coarse = record(tmp_path / "coarse", **motion, subframe_sharpness=0.6)
    many = sharp.sensor.subframes >= 4
    assert many.any() and not many.all()
    for t in range(FRAMES):
        a, b = (np.stack(s.frame(t).images).astype(float) for s in (sharp, coarse))
        off = np.abs(a - b).mean()
        assert (0.05 < off < 5.0) if many[t] else off == 0.0
    assert np.array_equal(sharp.truth.joints_2d, coarse.truth.joints_2d)


def test_presets_give_the_same_bytes_for_any_number_of_workers(tmp_path):
    one, two = scene(preset="harsh"), scene(preset="harsh")
    generate(one, tmp_path / "one", workers=0)
    generate(two, tmp_path / "two", workers=2)
    names = sorted(p.name for p in (tmp_path / "one").iterdir())
    assert {"rig.true.json", "sensor.npz"} <= set(names)
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    sequence = Sequence(tmp_path / "one")
    assert sequence.rig != sequence.true_rig
    assert not list((tmp_path / "one").glob("*.tmp"))


def test_sensor_tables_survive_toml_and_bad_ones_are_refused(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(to_toml(scene(preset="webcam", jpeg_quality=40)))
    assert load_scene(path) == scene(preset="webcam", jpeg_quality=40)
    off = scene(preset="webcam", jpeg_quality=0, full_well_e=0)
    path.write_text(to_toml(off))
    assert load_scene(path) == off and load_scene(path).sensor.jpeg_quality == 0
    path.write_text(to_toml(scene()) + '\n[sensor]\npreset = "sensor_plan"\n')
    with pytest.raises(FileError, match=r"sensor\.preset.*'webcam'"):
        load_scene(path)
    path.write_text(to_toml(scene()) + "\n[sensor]\nshutter = 0.1\n")
    with pytest.raises(FileError, match=r"unknown key.*shutter_s"):
        load_scene(path)


def test_a_fast_clock_runs_away_from_the_first_cameras(tmp_path, perfect):
    sequence = record(tmp_path / "s", clock_drift_ppm=8000.0, time_offset_s=0.002)
    taken, times = sequence.sensor.time, sequence.times
    np.testing.assert_allclose(taken[:, 0], times)
    np.testing.assert_allclose(taken[:, 1], 1.008 * times + 0.002)
    moved = np.abs(sequence.truth.joints_2d - perfect.truth.joints_2d).max((0, 2, 3))
    assert moved[0] < 1e-9 < 1e-3 < moved[1]


def test_verify_finds_a_sensor_file_of_another_length(tmp_path):
    sequence = record(tmp_path / "s", time_offset_s=0.01)
    folder = sequence.folder
    halved = {f.name: getattr(sequence.sensor, f.name)[:3] for f in fields(SensorTruth)}
    SensorTruth(**halved).save(folder / "sensor.npz")
    problems = verify(folder).problems
    assert any("sensor.npz" in problem for problem in problems)
