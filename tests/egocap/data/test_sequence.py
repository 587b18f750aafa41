"""Sequences: what is written is read back, and nothing damaged or foreign passes for whole."""

import contextlib
import json
import tarfile
import tracemalloc
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.body.proportions import Proportions
from egocap.cameras.rig_files import load_rig
from egocap.data.manifest import SCHEMA, Manifest, ShardEntry, load_manifest
from egocap.data.sequence import Sequence, largest_reduction
from egocap.data.sequence_writer import SequenceWriter, write_shard
from egocap.data.truth import Truth
from egocap.errors import FileError, InputError, MachineError
from egocap.files import replacing, write_atomically

ROOT = Path(__file__).parents[3]
FRAMES, SHARD = 5, 2
SIZE = (32, 24)


def manifest(**changes):
    config = {"seed": 3, "motion": {"name": "walk"}}
    content = {
        "schema_version": SCHEMA, "name": "tiny", "fps": 30.0, "frames": FRAMES,
        "shard_frames": SHARD, "views": ("left", "right"), "seed": 3, "config": config,
        "config_sha256": "0" * 64, "code_version": "1",
    }  # fmt: skip
    return Manifest(**(content | changes))


def image(index, view):
    picture = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    picture[:, :, 0], picture[:, :, 2] = 10 * index, 100 * view
    return picture


def frame_files(index):
    files = {
        f"{name}.png": cv2.imencode(".png", image(index, v)[..., ::-1])[1].tobytes()
        for v, name in enumerate(("left", "right"))
    }
    return files | {"json": json.dumps({"frame": index}).encode()}


def truth():
    rng = np.random.default_rng(0)
    shapes = {
        "time": (), "T_world_head": (4, 4), "joints_world": (18, 3), "joints_head": (18, 3),
        "joints_camera": (2, 18, 3), "joints_2d": (2, 18, 2), "in_view": (2, 18),
        "visibility": (2, 18), "T_world_body": (21, 4, 4), "contact": (4,), "ground_force": (2, 3),
        "root_wrench": (6,),
    }  # fmt: skip
    assert list(shapes) == [f.name for f in fields(Truth)]
    types = {"in_view": bool, "visibility": np.uint8, "contact": bool}
    return Truth(**{
        name: np.abs(rng.normal(size=(FRAMES, *shape))).astype(types.get(name, float))
        for name, shape in shapes.items()
    })  # fmt: skip


def side_files():
    rig = load_rig(ROOT / "scenes/rigs/egorig1.toml").resized(*SIZE)
    return {"rig.json": json.dumps(rig.to_dict()).encode()}


def write_all(folder, shards=range(3), **changes):
    with SequenceWriter(folder, manifest(**changes), side_files()) as writer:
        writer.begin()
        for i in shards:
            frames = writer.shard_range(i)
            entry = write_shard(folder, i, frames.start, (frame_files(k) for k in frames))
            writer.add_shard(entry)
        if len(shards) == 3:
            truth().save(folder / "t.tmp")
            writer.write_file("truth.npz", (folder / "t.tmp").read_bytes())
            (folder / "t.tmp").unlink()
    return folder


@pytest.fixture
def folder(tmp_path):
    return write_all(tmp_path / "seq")


def test_frames_come_back_as_written(folder):
    sequence = Sequence(folder)
    assert len(sequence) == FRAMES
    for frame in sequence:
        for v in range(2):
            assert np.array_equal(frame.images[v], image(frame.index, v))
    assert sequence.annotation(4) == {"frame": 4}
    assert np.allclose(sequence.times, np.arange(FRAMES) / 30.0)
    assert sequence.mask(0, "left") is None


def test_a_frame_holds_no_truth(folder):
    assert {f.name for f in fields(Sequence(folder).frame(0))} == {
        "index",
        "time",
        "images",
        "present",
    }


def test_truth_round_trips(folder):
    read, expected = Sequence(folder).truth, truth()
    for field in fields(Truth):
        assert np.array_equal(getattr(read, field.name), getattr(expected, field.name))


def test_tar_and_other_readers_need_nothing_of_ours(folder):
    with tarfile.open(folder / "shard-00001.tar") as tar:
        names = tar.getnames()
        assert names == [
            f"{k:06d}.{suffix}" for k in (2, 3) for suffix in ("left.png", "right.png", "json")
        ]
        data = tar.extractfile("000003.right.png").read()
    assert np.array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), 1)[..., ::-1], image(3, 1))
    assert np.load(folder / "truth.npz", allow_pickle=False)["joints_head"].shape == (FRAMES, 18, 3)


def test_the_same_frames_give_the_same_bytes(tmp_path, folder):
    other = write_all(tmp_path / "other")
    for path in sorted(folder.iterdir()):
        assert path.read_bytes() == (other / path.name).read_bytes(), path.name


def test_an_unfinished_sequence_is_not_read_and_is_completed(tmp_path, folder):
    part = write_all(tmp_path / "part", shards=[1])
    with pytest.raises(FileError, match="1 of 3 shards"):
        Sequence(part)
    (part / ".shard-00000.tar.77.tmp").write_bytes(b"left by a kill")
    with SequenceWriter(part, manifest(), side_files()) as writer:
        assert writer.pending() == [0, 2]
    assert not list(part.glob(".*.tmp"))


def test_a_damaged_shard_is_made_again(folder):
    path = folder / "shard-00001.tar"
    data = bytearray(path.read_bytes())
    data[600] ^= 1
    path.write_bytes(data)
    (folder / "shard-00002.tar").unlink()
    with SequenceWriter(folder, manifest(), side_files()) as writer:
        assert writer.pending() == [1, 2]


def test_another_sequence_is_not_overwritten(folder):
    other = manifest(config_sha256="1" * 64, config={"seed": 3, "motion": {"name": "run"}})
    with pytest.raises(InputError, match=r"motion\.name: 'walk' recorded, 'run' requested"):
        SequenceWriter(folder, other, {}).__enter__()
    with pytest.raises(InputError, match="begun with version 1, this is 2"):
        SequenceWriter(folder, manifest(code_version="2"), {}).__enter__()


def test_a_sequence_that_was_not_begun_leaves_no_folder(tmp_path):
    with SequenceWriter(tmp_path / "new", manifest(), side_files()):
        pass
    (tmp_path / "there").mkdir()
    with SequenceWriter(tmp_path / "there", manifest(), side_files()):
        pass
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_a_failed_start_leaves_a_folder_for_other_options(tmp_path):
    def start(frames):
        return SequenceWriter(tmp_path / "s", manifest(frames=frames), side_files())

    with pytest.raises(RuntimeError), start(500) as writer:
        writer.begin()
        (writer.folder / "draft.npz").write_bytes(b"of this run")
        raise RuntimeError
    assert not (tmp_path / "s").exists()
    with start(60) as writer:
        writer.begin()
    assert writer.manifest.frames == 60 and (tmp_path / "s" / "manifest.json").is_file()


def test_a_folder_with_other_files_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("dear to me")
    with pytest.raises(InputError, match=r"thesis\.tex"):
        SequenceWriter(tmp_path, manifest(), {}).__enter__()
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_two_processes_do_not_write_one_folder(folder):
    with (
        SequenceWriter(folder, manifest(), side_files()),
        pytest.raises(MachineError, match="another process"),
    ):
        SequenceWriter(folder, manifest(), side_files()).__enter__()


def test_a_shard_that_was_listed_just_before_an_interruption_is_kept(tmp_path, monkeypatch):
    @contextlib.contextmanager
    def interrupted(path):
        with replacing(path) as temporary:
            yield temporary
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), SequenceWriter(tmp_path, manifest(), {}) as writer:
        writer.begin()
        entry = write_shard(tmp_path, 0, 0, [frame_files(i) for i in writer.shard_range(0)])
        monkeypatch.setattr("egocap.data.sequence_writer.replacing", interrupted)
        writer.add_shard(entry)
    assert list(load_manifest(tmp_path).shards) == [entry]
    assert (tmp_path / entry.name).exists()


def test_listed_frames_take_little_memory(tmp_path):
    def entry(index: int) -> ShardEntry:
        files = {f"{name}.jpg": (10_000 + index, 20_000 + index) for name in ("left", "right")}
        return ShardEntry(
            name=f"shard-{index:05d}.tar",
            first=50 * index,
            bytes=1,
            sha256=f"{index:064x}",
            frames=[dict(files) for _ in range(50)],
        )

    long = manifest(frames=5000, shard_frames=50)
    with SequenceWriter(tmp_path, long, {}) as writer:
        writer.begin()
        writer.add_shard(entry(0))
        tracemalloc.start()
        try:
            for index in range(1, 100):
                writer.add_shard(entry(index))
            held, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert held / 4950 < 200  # bytes a frame
    assert load_manifest(tmp_path).shards == [entry(index) for index in range(100)]


def test_an_interruption_in_the_first_shard_leaves_files_that_were_there_before(tmp_path):
    (tmp_path / "rig.json").write_text("of an earlier run")
    files = side_files() | {"times.npz": b"of this run"}
    with pytest.raises(KeyboardInterrupt), SequenceWriter(tmp_path, manifest(), files) as writer:
        writer.begin()
        assert (tmp_path / "times.npz").exists()
        raise KeyboardInterrupt
    assert [path.name for path in tmp_path.iterdir()] == ["rig.json"]


def test_a_full_disk_is_said_and_leaves_nothing_half_written(tmp_path, monkeypatch):
    def no_space(fd):
        raise OSError(28, "No space left on device")

    target = tmp_path / "manifest.json"
    target.write_bytes(b"old")
    monkeypatch.setattr("os.fsync", no_space)
    with pytest.raises(MachineError, match="disk is full"):
        write_atomically(target, b"new")
    assert target.read_bytes() == b"old"
    with pytest.raises(MachineError, match=r"shard-00000\.tar: the disk is full"):
        write_shard(tmp_path, 0, 0, [frame_files(0)])
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]


def test_a_file_cannot_take_the_place_of_a_folder(tmp_path):
    with pytest.raises(FileError, match="is a folder"):
        write_atomically(tmp_path, b"new")
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(FileError, match="is not a folder"):
            SequenceWriter(folder, manifest(), {}).__enter__()


@pytest.mark.parametrize("order", [(0, 0, 2), (2, 1, 0)])
def test_shards_listed_twice_or_out_of_order_are_refused(folder, order):
    path = folder / "manifest.json"
    content = json.loads(path.read_text())
    content["shards"] = [content["shards"][i] for i in order]
    path.write_text(json.dumps(content))
    with pytest.raises(FileError, match=r"'shards\.1': .* repeated or out of order"):
        Sequence(folder)


def test_a_damaged_image_names_shard_frame_and_view(folder):
    path = folder / "shard-00001.tar"
    offset, size = Sequence(folder).manifest.shards[1].frames[0]["right.png"]
    data = bytearray(path.read_bytes())
    data[offset : offset + size] = bytes(size)
    path.write_bytes(data)
    with pytest.raises(FileError, match=r"shard-00001\.tar: frame 2: 'right\.png' is damaged"):
        Sequence(folder).frame(2)


def test_a_rig_of_other_views_is_refused(folder):
    text = (folder / "rig.json").read_text().replace('"left"', '"port"')
    (folder / "rig.json").write_text(text)
    with pytest.raises(FileError, match=r"rig\.json: has the views"):
        _ = Sequence(folder).rig


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema_version": SCHEMA + 1}, "newer version"),
        ({"fps": 0}, "'fps'"),
        ({"surprise": 1}, "unknown key"),
        ({"shards": [{"name": "../../etc/passwd"}]}, "shards.0.name"),
        ({"files": {"../../../etc/hostname": {"bytes": 1, "sha256": "0" * 64}}}, "hostname"),
        ({"views": ["../left"]}, "views.0"),
        ({"frames": 4}, "shard"),
    ],
)
def test_a_wrong_manifest_is_an_error_that_names_the_key(folder, change, message):
    path = folder / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(FileError, match=message):
        Sequence(folder)


@settings(deadline=None, max_examples=60)
@given(cut=st.integers(0, 3000), flip=st.integers(0, 3000))
def test_a_mangled_manifest_never_passes_silently_or_crashes(tmp_path_factory, cut, flip):
    folder = tmp_path_factory.mktemp("mangled") / "seq"
    write_all(folder)
    path = folder / "manifest.json"
    data = bytearray(path.read_bytes())
    data[flip % len(data)] ^= 0x15
    path.write_bytes(data[: len(data) - cut % len(data)])
    with contextlib.suppress(FileError, InputError):
        list(Sequence(folder))


def test_missing_and_truncated_shards_name_themselves(folder):
    sequence = Sequence(folder)
    path = folder / "shard-00001.tar"
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(FileError, match=r"shard-00001\.tar: shard is truncated"):
        sequence.frame(3)
    path.unlink()
    with pytest.raises(FileError, match=r"shard-00001\.tar"):
        sequence.frame(3)
    with pytest.raises(InputError, match="0 to 4"):
        sequence.frame(5)


def test_a_pickle_in_truth_is_not_loaded(folder):
    np.savez(folder / "truth.npz", time=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FileError, match=r"truth\.npz"):
        _ = Sequence(folder).truth


def test_proportions_and_rig_are_read_where_a_tracker_needs_them(folder):
    Proportions.from_lengths(1.8).save(folder / "body.json")
    sequence = Sequence(folder)
    assert sequence.rig.views == ("left", "right")
    assert sequence.body.offsets.shape == (22, 3)


@pytest.mark.parametrize(
    ("size", "most", "factor"),
    [((640, 512), 2.0, 2), ((640, 512), 1.9, 1), ((1280, 1024), 100.0, 8), ((640, 508), 8.0, 4),
     ((641, 512), 8.0, 1)],
)  # fmt: skip
def test_a_jpeg_is_decoded_smaller_by_factors_that_divide_it(size, most, factor):
    camera = SimpleNamespace(width=size[0], height=size[1])
    assert largest_reduction(camera, most) == factor
