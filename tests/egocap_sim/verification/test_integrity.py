"""A sequence is clean, or every thing wrong with it is named."""

import io
import json
import re
import shutil
import tarfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from egocap.data.sequence import Sequence
from egocap.data.truth import OUT_OF_VIEW, Truth
from egocap.detect.canonical_view import ViewSpec
from egocap.detect.input_images import recorded_pictures
from egocap.detect.train.examples import build_store
from egocap.errors import FileError
from egocap.files import sha256
from egocap.head_pose.pictures import grey_frames
from egocap_sim.export.preview import contact_sheet
from egocap_sim.record.recorder import generate
from egocap_sim.verification.integrity import frames_to_check, verify


@pytest.fixture
def folder(tiny_sequence: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(tiny_sequence, tmp_path / "copy"))


def edit_manifest(folder: Path, change) -> None:
    path = folder / "manifest.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def flip_byte(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)


def resave_truth(folder: Path, **arrays: np.ndarray) -> None:
    """Truth with other values, recorded in the manifest as if it had been written so."""
    from dataclasses import replace

    from egocap.data.sequence_writer import FileEntry, hashlib

    path = folder / "truth.npz"
    replace(Truth.load(path), **arrays).save(path)
    data = path.read_bytes()
    entry = FileEntry(bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
    edit_manifest(folder, lambda m: m["files"].update({"truth.npz": entry.model_dump()}))


@pytest.mark.parametrize("rays", [0, 2])
def test_every_frame_to_check_is_told(folder, rays):
    told = []
    assert verify(folder, rays, told.append).clean
    assert sum(told) == frames_to_check(folder, rays) == (rays or 7)


def test_a_generated_sequence_is_clean(folder):
    result = verify(folder)
    assert result.clean and result.frames == 7
    on_disk = sum(p.stat().st_size for p in folder.iterdir() if p.name != "manifest.json")
    assert result.bytes == on_disk


@pytest.mark.parametrize("name", ["shard-00002.tar", "truth.npz", "rig.json", "body.json"])
def test_missing_and_damaged_files_are_named_once(folder, name):
    flip_byte(folder / name, (folder / name).stat().st_size // 2)
    (damaged,) = verify(folder).problems
    assert damaged.startswith(name) and "checksum" in damaged
    (folder / name).unlink()
    assert verify(folder).problems == (f"{name}: is missing",)


def test_all_damage_is_listed(folder):
    for name in ("shard-00000.tar", "shard-00003.tar", "scene.toml"):
        (folder / name).unlink()
    assert len(verify(folder).problems) == 3


def test_an_unfinished_sequence_says_what_is_missing(folder):
    edit_manifest(folder, lambda m: m["shards"].pop())
    assert verify(folder).problems == ("unfinished: 1 of 4 shards are not there yet",)


def test_an_unfinished_truth_is_said(folder):
    edit_manifest(folder, lambda m: m["files"].pop("truth.npz"))
    assert verify(folder).problems == ("unfinished: truth.npz is not there yet",)


def test_a_changed_configuration_is_seen(folder):
    edit_manifest(folder, lambda m: m["config"].update(seed=7))
    assert "configuration" in verify(folder).problems[0]


def test_an_index_that_points_elsewhere_is_seen(folder):
    edit_manifest(folder, lambda m: m["shards"][1]["frames"][0].update({"left.jpg": [512, 9]}))
    assert any("shard-00001.tar: its members differ" in p for p in verify(folder).problems)


def rewrite_shard(folder: Path, name: str, content: bytes | None) -> None:
    """Frames 2 and 3 with another file of that name, or without it; every checksum is right."""
    path = folder / "shard-00001.tar"
    with tarfile.open(path) as tar:
        files = {member.name: tar.extractfile(member).read() for member in tar}
    files = {n: content if n.endswith(name) else data for n, data in files.items()}
    frames: list[dict] = [{}, {}]
    with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
        for member, data in files.items():
            if data is not None:
                info = tarfile.TarInfo(member)
                info.size, start = len(data), tar.offset
                tar.addfile(info, io.BytesIO(data))
                frames[int(member[:6]) - 2][member[7:]] = [start + 512, len(data)]
    entry = {"bytes": path.stat().st_size, "sha256": sha256(path), "frames": frames}
    edit_manifest(folder, lambda m: m["shards"][1].update(entry))


@pytest.mark.parametrize("content", [b"{}", b'{"visibility": {"left": [1], "right": [1]}}'])
def test_a_damaged_annotation_of_an_earlier_run_ends_the_next_one(folder, tiny_scene, content):
    rewrite_shard(folder, ".json", content)
    edit_manifest(folder, lambda m: m["files"].pop("truth.npz"))
    with pytest.raises(FileError, match=r"shard-00001.tar.*frame 2: annotation damaged"):
        generate(tiny_scene, folder)


def image(shape, suffix=".png", dtype=np.uint8) -> bytes:
    return cv2.imencode(suffix, np.zeros(shape, dtype))[1].tobytes()


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        (
            "left.mask.png",
            image((64, 80)),
            "has 80 x 64 .*160 x 128. .* 2 and 1 more",
        ),
        ("left.depth.png", image((9, 160), dtype=np.uint16), "'left.depth.png' has 160 x 9"),
        ("left.mask.png", image((128, 160), dtype=np.uint16), "is uint16 .*valid: uint8"),
        ("right.depth.png", image((128, 160, 3)), "is uint8 .*valid: uint16, one value"),
        ("000003.right.jpg", image((64, 80, 3), ".jpg"), "'right.jpg' has 80 x 64 .* frame 3$"),
        ("000003.right.jpg", b"no image", "'right.jpg' is damaged in frame 3"),
        ("000003.right.jpg", None, "no 'right.jpg' in frame 3"),
        ("right.mask.png", None, "no 'right.mask.png' in frame 2 and 1 more"),
        ("000003.json", None, "no 'json' in frame 3"),
    ],
)
def test_pictures_labels_and_depth_of_every_frame_are_checked(folder, name, content, says):
    rewrite_shard(folder, name, content)
    (problem,) = verify(folder).problems
    assert "shard-00001.tar" in problem and re.search(says, problem), problem


@pytest.mark.parametrize("name", ["left.mask.png", "left.jpg"])
def test_a_preview_of_pictures_of_another_size_is_refused(folder, name, tmp_path):
    rewrite_shard(folder, name, image((64, 80, 3)[: 3 - name.count("mask")], Path(name).suffix))
    with pytest.raises(FileError, match=r"shard-00001.tar: frame 2: .* 80 x 64 .*valid: 160 x 128"):
        contact_sheet(Sequence(folder), rows=7, tile_width=80)


def test_a_preview_of_frames_without_part_labels(folder):
    rewrite_shard(folder, ".mask.png", None)
    sheet = contact_sheet(Sequence(folder), rows=7, tile_width=80)
    rows = np.split(sheet, 7)
    assert [bool(row[:, 240:].any()) for row in rows] == [True] * 2 + [False] * 2 + [True] * 3


@pytest.mark.parametrize(
    "content", [b"[]", b"", b"[" * 10_000, b'{"joints_2d": null}', b'{"visibility": {}}', b"\xff"]
)
def test_damaged_annotations_are_left_out_of_training(folder, content, tmp_path, caplog):
    rewrite_shard(folder, ".json", content)
    store = build_store([folder], ViewSpec(64, 64, 28.0), tmp_path)
    assert len(store) == 2 * 5 and store.skipped == 2 * 2
    assert "shard-00001.tar" in caplog.text


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"{}", "'visibility' of frame 2 differs"), (b'{"visibility": {}}', "'visibility' of frame 2"),
     (b"[]", "not"), (b"\xff", "not")],
)  # fmt: skip
def test_annotations_that_contradict_the_truth_are_seen(folder, content, says):
    rewrite_shard(folder, ".json", content)
    problems = verify(folder).problems
    assert len(problems) == 1 and says in problems[0] and "shard-00001.tar" in problems[0]


def test_a_joint_that_was_moved_in_an_annotation_is_seen(folder):
    said = Sequence(folder).annotation(3)
    said["joints_head"][5][2] += 1e-6
    rewrite_shard(folder, "000003.json", json.dumps(said).encode())
    (problem,) = verify(folder).problems
    assert problem == "shard-00001.tar: 'joints_head' of frame 3 differs from truth.npz"


def test_a_shard_that_is_no_archive_is_said(folder):
    path = folder / "shard-00001.tar"
    path.write_bytes(b"x" * 1024)
    entry = {"bytes": 1024, "sha256": sha256(path)}
    edit_manifest(folder, lambda m: m["shards"][1].update(entry))
    assert "shard-00001.tar: not a whole tar archive" in verify(folder).problems[0]


def test_a_missing_picture_leaves_the_other_view(folder):
    rewrite_shard(folder, "000003.right.jpg", None)
    sequence = Sequence(folder)
    frame = sequence.frame(3)
    assert frame.present == (True, False) and not frame.images[1].any()
    assert recorded_pictures(sequence, 3)[1] is None
    (grey,) = grey_frames(sequence, sequence.rig, range(3, 4))
    assert grey[1][0] is not None and grey[1][1] is None


def test_truth_that_contradicts_itself_is_seen(folder):
    truth = Truth.load(folder / "truth.npz")
    resave_truth(folder, joints_head=truth.joints_head + 0.01)
    assert any("do not map to 'joints_world'" in p for p in verify(folder).problems)
    resave_truth(folder, joints_head=truth.joints_head, joints_2d=truth.joints_2d + 0.5)
    assert any("'joints_2d' of left does not follow" in p for p in verify(folder).problems)
    resave_truth(folder, joints_2d=truth.joints_2d, root_wrench=truth.root_wrench * np.nan)
    assert verify(folder).problems == ("truth.npz: 'root_wrench' has values that are not finite",)
    hidden = np.full_like(truth.visibility, OUT_OF_VIEW)
    resave_truth(folder, root_wrench=truth.root_wrench, visibility=hidden)
    assert verify(folder).problems == ("truth.npz: 'visibility' contradicts 'in_view'",)


def test_what_is_no_sequence_is_an_error(tmp_path):
    with pytest.raises(FileError, match="no such folder"):
        verify(tmp_path / "none")
    with pytest.raises(FileError, match=r"not a sequence: it has no manifest\.json"):
        verify(tmp_path)
