"""Canonical views of sequences: labels where the truth is, damage left out and counted."""

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from egocap.body.labels import MIRROR
from egocap.data.sequence import Sequence
from egocap.data.truth import OUT_OF_VIEW, VISIBLE
from egocap.detect.canonical_view import CanonicalView, ViewSpec
from egocap.detect.train.examples import (
    HIDDEN,
    OUTSIDE,
    SEEN,
    build_store,
    mixed,
    sequence_views,
)
from egocap.errors import FileError

SPEC = ViewSpec(64, 64, 28.0)


def test_labels_are_the_truth_in_the_views_order(tiny_sequence, tmp_path):
    sequence = Sequence(tiny_sequence)
    views = sequence_views(tiny_sequence, SPEC, tmp_path)
    assert len(views) == 2 * len(sequence) and views.images.shape[1:] == (64, 64, 3)
    truth = sequence.truth
    for v, mount in enumerate(sequence.rig.mounts):
        view = CanonicalView(mount, SPEC)
        for t in range(len(sequence)):
            row = np.flatnonzero([np.array_equal(views.images[i], view.image(
                sequence.frame(t).images[v])) for i in range(len(views))])  # fmt: skip
            assert len(row) >= 1
            state = views.state[row[0]]
            order = np.array(MIRROR) if view.mirrored else np.arange(18)
            expected = truth.visibility[t, v][order]
            np.testing.assert_array_equal(state == SEEN, (expected == VISIBLE) & (state != OUTSIDE))
            assert (state[expected == OUT_OF_VIEW] == OUTSIDE).all()
            back, valid = view.to_camera(views.points[row[0]])
            inside = state != OUTSIDE
            assert valid[inside].all()
            np.testing.assert_allclose(
                back[inside], truth.joints_2d[t, v][order][inside], atol=0.01
            )
    assert {SEEN, HIDDEN} <= set(np.unique(views.state))


def test_store_is_read_again(tiny_sequence, tmp_path):
    first = sequence_views(tiny_sequence, SPEC, tmp_path)
    (place,) = tmp_path.iterdir()
    stamp = (place / "images.npy").stat().st_mtime_ns
    second = sequence_views(tiny_sequence, SPEC, tmp_path)
    assert (place / "images.npy").stat().st_mtime_ns == stamp
    np.testing.assert_array_equal(first.images, second.images)
    sequence_views(tiny_sequence, ViewSpec(32, 32, 14.0), tmp_path)
    assert len(list(tmp_path.iterdir())) == 2  # another view, another place


def _cut(file):
    file.write_bytes(file.read_bytes()[:100])


def _empty(file):
    file.write_bytes(b"")


def _of_another_type(file):
    if file.suffix == ".npy":
        np.save(file, np.load(file).astype(np.float32))
    else:
        np.savez(file, **dict(np.load(file)) | {"skipped": np.array("many")})


def _a_zip_archive(file):
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("x.npy", b"x")


def _of_huge_shape(file):
    with file.open("wb") as out:
        np.lib.format.write_array_header_1_0(
            out, {"descr": "|u1", "fortran_order": False, "shape": (10**30, 64, 64, 3)}
        )


def _of_labels_out_of_range(file):
    if file.suffix == ".npy":
        np.save(file, np.load(file).astype("U1"))
    else:
        found = dict(np.load(file))
        np.savez(file, **found | {"points": np.full_like(found["points"], np.inf)})


def _a_file_for_the_folder(file):
    shutil.rmtree(file.parent)
    file.parent.write_text("")


def _short_of_a_view(file):
    if file.suffix == ".npy":
        np.save(file, np.load(file)[1:])
    else:
        np.savez(file, **dict(np.load(file)) | {"points": np.zeros((3, 18, 2), np.float32)})


DAMAGES = [_cut, _empty, _of_another_type, _a_zip_archive, _of_huge_shape, _of_labels_out_of_range,
           _a_file_for_the_folder, _short_of_a_view, Path.unlink]  # fmt: skip


@pytest.mark.parametrize("name", ["labels.npz", "images.npy"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_store_is_made_again(tiny_sequence, tmp_path, caplog, name, damage):
    whole = build_store([tiny_sequence], SPEC, tmp_path)
    wanted = whole.sequences[0].images.copy()
    (file,) = tmp_path.glob(f"*/{name}")
    damage(file)
    again = build_store([tiny_sequence], SPEC, tmp_path)
    assert "made again" in caplog.text and again.skipped == whole.skipped
    np.testing.assert_array_equal(again.sequences[0].images, wanted)


def test_damaged_shard_is_left_out_and_counted(tiny_sequence, tmp_path, caplog):
    folder = tmp_path / "sequence"
    shutil.copytree(tiny_sequence, folder)
    shard = folder / "shard-00001.tar"  # frames 2 and 3
    shard.write_bytes(shard.read_bytes()[:700])
    store = build_store([folder, tmp_path / "nothing"], SPEC, tmp_path / "store")
    whole = len(Sequence(tiny_sequence)) * 2
    assert len(store) == whole - 4
    assert store.skipped == 4 + 1  # views, and a folder that is no sequence
    assert "shard-00001.tar" in caplog.text and "skipped" in caplog.text


def test_store_finds_views_by_number(tiny_sequence, tmp_path):
    store = build_store([tiny_sequence, tiny_sequence], SPEC, tmp_path)
    half = len(store) // 2
    assert store.locate(half - 1) == (store.sequences[0], half - 1)
    assert store.locate(half) == (store.sequences[1], 0)


def test_draws_follow_the_shares(tiny_sequence, tmp_path):
    one = build_store([tiny_sequence], SPEC, tmp_path)
    three = build_store([tiny_sequence] * 3, SPEC, tmp_path)
    store = mixed([one, three], [1.0, 1.0])
    rng = np.random.default_rng(7)
    drawn = [store.draw(rng) for _ in range(2000)]
    from_one = np.mean([views is store.sequences[0] for views, _ in drawn])
    assert abs(from_one - 0.5) < 0.05  # a quarter without shares
    assert {row for _, row in drawn} == set(range(len(one)))
    alone = np.mean([three.draw(rng)[0] is three.sequences[0] for _ in range(2000)])
    assert abs(alone - 1 / 3) < 0.05


def test_nothing_readable_is_an_error(tmp_path):
    with pytest.raises(FileError, match="none of the sequences"):
        build_store([tmp_path], SPEC, tmp_path / "store")
