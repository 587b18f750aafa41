"""Sequences of footage: no truth, true times, pictures where they were."""

import cv2
import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap.data.footage import Footage, FootageView, FrameTimes, ViewColour, ViewTiming
from egocap.data.manifest import SCHEMA, Manifest
from egocap.data.sequence import Sequence
from egocap.data.sequence_writer import SequenceWriter
from egocap.errors import FileError, InputError
from egocap.media.pictures import PictureOptions
from egocap.media.source import Part

RIG = "scenes/rigs/egorig1.toml"
TIMES = np.array([0.0, 0.04, 0.10])


@pytest.fixture
def folder(tmp_path, request):
    """Three frames of two views side by side in one picture; the right view lacks the second."""
    import json

    rig = load_rig(request.config.rootpath / RIG).resized(32, 24)
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for i in range(3):
        both = np.full((24, 64, 3), 10 * i, np.uint8)
        both[:, 32:] += 100
        cv2.imwrite(str(pictures / f"{i}.png"), both)
    views = tuple(
        FootageView(name=name, path=str(pictures), part=Part(v, 2), options=PictureOptions(fps=25),
                    bytes=0, sha256="0" * 64, colour=ViewColour(gain=(1.0, 1.0 + v, 0.5)))
        for v, name in enumerate(rig.views)
    )  # fmt: skip
    present = np.array([[True, True], [True, False], [True, True]])
    source = np.array([[0, 0], [1, 0], [2, 2]])
    files = {
        "rig.json": json.dumps(rig.to_dict()).encode(),
        "footage.json": Footage(views=views).model_dump_json().encode(),
        "times.npz": FrameTimes(TIMES, np.repeat(TIMES[:, None], 2, 1), source, present).content(),
    }
    manifest = Manifest(
        schema_version=SCHEMA, name="mine", fps=25.0, frames=3, shard_frames=50, views=rig.views,
        seed=0, truth=False, shards_hold_images=False, config={}, config_sha256="0" * 64,
        code_version="1",
    )  # fmt: skip
    with SequenceWriter(tmp_path / "sequence", manifest, files) as writer:
        writer.begin()
    return tmp_path / "sequence"


def test_pictures_are_read_where_they_are(folder):
    sequence = Sequence(folder)
    frames = list(sequence)
    assert [frame.present for frame in frames] == [(True, True), (True, False), (True, True)]
    np.testing.assert_array_equal(frames[2].images[0][3, 4], [20, 20, 10])
    np.testing.assert_array_equal(frames[2].images[1][3, 4], [120, 240, 60])
    assert frames[1].images[1].shape == (24, 32, 3) and not frames[1].images[1].any()
    assert sequence.pictures(1)[1] is None


def test_times_are_those_recorded(folder):
    sequence = Sequence(folder)
    np.testing.assert_array_equal(sequence.times, TIMES)
    assert [frame.time for frame in sequence] == TIMES.tolist()


def test_what_footage_lacks_is_said_in_one_line(folder):
    sequence = Sequence(folder)
    assert "no truth" in repr(sequence) and sequence.sensor is None and sequence.others is None
    with pytest.raises(FileError, match="footage, which has no truth"):
        _ = sequence.truth
    with pytest.raises(FileError, match="--body"):
        _ = sequence.body
    with pytest.raises(InputError, match="no frame 3"):
        sequence.images(3)


def test_pictures_that_went_away_are_named(folder):
    for path in (folder.parent / "pictures").iterdir():
        path.unlink()
    with pytest.raises(FileError, match="holds no pictures"):
        Sequence(folder).images(0)


def test_times_by_the_common_clock():
    timing = ViewTiming(offset_s=2.5, drift_ppm=50.0)
    own = np.array([0.0, 1.0, 100.0])
    np.testing.assert_allclose(timing.to_common(own), [2.5, 3.50005, 102.505], rtol=1e-12)


@pytest.mark.parametrize("key, value, message", [
    ("source", np.array([[0, 0], [1, 0], [2, 3]]), "has no picture 3"),
    ("source", np.array([[0, 0], [1, 0], [-1, 2]]), "has no picture -1"),
    ("present", np.ones((3, 1), bool), "key 'present': has shape"),
    ("time", np.array([0.0, np.inf, 1.0]), "finite times"),
])  # fmt: skip
def test_times_that_do_not_fit_are_refused(folder, key, value, message):
    arrays = dict(np.load(folder / "times.npz"))
    arrays[key] = value
    if key == "present":
        arrays |= {name: arrays[name][:, :1] for name in ("taken", "source")}
    np.savez(folder / "times.npz", **arrays)
    with pytest.raises(FileError, match=message):
        list(Sequence(folder))


def test_part_of_a_picture_that_is_none_is_refused(folder):
    import json

    data = json.loads((folder / "footage.json").read_text())
    data["views"][1]["part"] = [1, 0]
    (folder / "footage.json").write_text(json.dumps(data))
    with pytest.raises(FileError, match="part 1 of 0"):
        list(Sequence(folder))


def test_views_that_are_not_the_manifests_are_refused(folder):
    import json

    data = json.loads((folder / "footage.json").read_text())
    data["views"].pop()
    (folder / "footage.json").write_text(json.dumps(data))
    with pytest.raises(FileError, match="other views than the manifest"):
        list(Sequence(folder))


def test_edited_rig_is_pointed_out(folder, caplog):
    _ = Sequence(folder).rig
    assert not caplog.records
    path = folder / "rig.json"
    path.write_text(path.read_text() + " ")
    _ = Sequence(folder).rig
    assert "is not the rig that was recorded" in caplog.text
