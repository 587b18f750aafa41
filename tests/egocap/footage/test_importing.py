"""Import: every picture at its own time, what was lost reported, bad footage refused."""

import json

import numpy as np
import pytest

from egocap.data.footage import FootageView
from egocap.data.sequence import Sequence
from egocap.errors import FileError, InputError
from egocap.footage import importing
from egocap.footage.config import ImportOptions, Range
from egocap.footage.importing import edit_footage, import_footage
from egocap.footage.sources import scan_name
from egocap.footage.summary import describe, summary
from egocap.media.pictures import PictureOptions

from .conftest import film, pictures, scene

EVERY = np.arange(40) / 30.0
BOTH = ImportOptions()


def of(tmp_path, rig, left, right, options=BOTH, shown=None):
    sources = [
        film(tmp_path / f"{name}.mp4", times, v, (shown or {}).get(name))
        for v, (name, times) in enumerate((("left", left), ("right", right)))
    ]
    return import_footage(sources, rig, tmp_path / "sequence", options)


def shows(sequence, index, view, time):
    """Whether a frame's picture is that of the scene at a time, and no other picture's."""
    image = sequence.images(index)[view].astype(float)
    error = [np.abs(image - scene(t, view)).mean() for t in (time, time - 1 / 30, time + 1 / 30)]
    return error[0] < 12 and error[0] < 0.5 * min(error[1:])


@pytest.mark.parametrize("copy", [False, True])
def test_frames_are_the_pictures_at_their_times(tmp_path, rig, copy):
    sequence = of(tmp_path, rig, EVERY, EVERY, ImportOptions(copy=copy))
    assert len(sequence) == 40 and sequence.rig.views == ("left", "right")
    np.testing.assert_allclose(sequence.times, EVERY, atol=2e-5)
    assert all(shows(sequence, i, v, EVERY[i]) for i in (0, 7, 3, 39) for v in (0, 1))
    found = summary(sequence)["views"]["right"]
    assert [found[k] for k in ("dropped", "repeated", "damaged", "frames_without")] == [0] * 4
    if copy:
        (tmp_path / "left.mp4").unlink()
        assert shows(Sequence(sequence.folder), 5, 0, EVERY[5])


def test_dropped_and_repeated_pictures_are_reported_and_missing(tmp_path, rig):
    dropped = np.delete(EVERY, [10, 11, 25])
    repeated = EVERY.copy()
    repeated[[6, 30]] = EVERY[[5, 29]]
    sequence = of(tmp_path, rig, dropped, EVERY, shown={"right": repeated})
    left, right = (summary(sequence)["views"][v] for v in ("left", "right"))
    assert (left["dropped"], left["repeated"]) == (3, 0)
    assert (right["dropped"], right["repeated"]) == (0, 2)
    assert len(sequence) == 40
    present = sequence.frame_times.present
    assert np.flatnonzero(~present[:, 0]).tolist() == [10, 11, 25]
    assert np.flatnonzero(~present[:, 1]).tolist() == [6, 30]
    assert shows(sequence, 26, 0, EVERY[26]) and shows(sequence, 26, 1, EVERY[26])
    assert "3 dropped" in describe(sequence)[1] and "2 repeated" in describe(sequence)[2]


def test_a_still_scene_is_not_repeated(tmp_path, rig):
    still = np.concatenate([EVERY[:10], np.full(20, EVERY[9]), EVERY[10:20]])
    sequence = of(tmp_path, rig, EVERY, EVERY, shown={"left": still, "right": still})
    assert summary(sequence)["views"]["left"]["frames_without"] <= 2  # where the motion stops


def test_variable_frame_rates_keep_their_times(tmp_path, rig):
    rng = np.random.default_rng(2)
    uneven = EVERY + rng.uniform(-0.006, 0.006, len(EVERY)).clip(0 - EVERY[0])
    sequence = of(tmp_path, rig, uneven, EVERY)
    np.testing.assert_allclose(sequence.times, uneven, atol=2e-5)
    assert sequence.frame_times.present.all()
    np.testing.assert_allclose(sequence.frame_times.taken[:, 1], EVERY, atol=2e-5)


def test_given_lag_and_drift_pair_the_views(tmp_path, rig):
    own = 0.5 + EVERY * (1 + 400e-6)
    options = ImportOptions(lag=(0.5,), drift=(400.0,))
    sequence = of(tmp_path, rig, EVERY, own, options, shown={"right": EVERY})
    assert len(sequence) == 40 and shows(sequence, 20, 1, EVERY[20])
    np.testing.assert_allclose(sequence.frame_times.taken[:, 1], sequence.times, atol=3e-5)
    assert sequence.footage.views[1].timing.origin == "given"


def test_an_edit_sets_clocks_and_range_from_the_scans_that_are_there(tmp_path, rig, monkeypatch):
    own = 0.5 + EVERY
    sequence = of(tmp_path, rig, EVERY, own, shown={"right": EVERY})
    wrong = sequence.footage.views[1].timing
    monkeypatch.setattr("egocap.footage.sources.scan", None)  # nothing is decoded again
    edited = edit_footage(sequence.folder, ImportOptions(lag=(0.5,)))
    assert wrong.origin == "assumed" and edited.footage.views[1].timing.origin == "given"
    assert len(edited) == 40 and shows(edited, 20, 1, EVERY[20])
    part = edit_footage(sequence.folder, ImportOptions(range=Range(start=0.32, end=0.61)))
    np.testing.assert_allclose(part.times, EVERY[10:19], atol=2e-5)
    assert part.footage.views[1].timing.offset_s == pytest.approx(-0.5)  # as edited before
    whole = import_footage([tmp_path / "left.mp4", tmp_path / "right.mp4"], rig, sequence.folder)
    assert whole.footage.views[1].timing == wrong  # a whole call sets everything


def test_a_refused_edit_leaves_the_sequence_as_it_was(tmp_path, rig):
    sequence = of(tmp_path, rig, EVERY, EVERY, ImportOptions(range=Range(start=0.32, end=0.61)))
    with pytest.raises(InputError, match="no frames between"):
        edit_footage(sequence.folder, ImportOptions(range=Range(start=1000.0)))
    again = Sequence(sequence.folder)
    np.testing.assert_allclose(again.times, EVERY[10:19], atol=2e-5)
    assert shows(again, 3, 1, EVERY[13])
    assert again.manifest.config["options"]["range"]["start"] == 0.32


def test_an_edit_of_one_end_keeps_the_rest_of_the_range(tmp_path, rig):
    options = ImportOptions(range=Range(start=0.32, keep_single=True))
    sequence = of(tmp_path, rig, EVERY, EVERY[:15], options)
    np.testing.assert_allclose(sequence.times, EVERY[10:], atol=2e-5)
    part = edit_footage(sequence.folder, ImportOptions(range=Range(end=0.75)))
    np.testing.assert_allclose(part.times, EVERY[10:23], atol=2e-5)


def test_an_edit_refuses_options_that_it_does_not_change(tmp_path, rig):
    sequence = of(tmp_path, rig, EVERY, EVERY)
    with pytest.raises(InputError, match="an option that an edit does not change"):
        edit_footage(sequence.folder, ImportOptions(copy=True))
    assert not Sequence(sequence.folder).manifest.shards_hold_images


def test_drift_alone_is_refused(tmp_path, rig):
    with pytest.raises(InputError, match="--drift without --lag"):
        of(tmp_path, rig, EVERY, EVERY, ImportOptions(drift=(5.0,)))


def test_a_scan_is_that_of_pictures_read_with_the_same_options(tmp_path, rig):
    def named(fps):
        return scan_name(FootageView(name="left", path="/left", options=PictureOptions(fps=fps),
                                     bytes=1, sha256="0" * 64), rig)  # fmt: skip

    assert named(30.0) == named(30.0) and len({named(None), named(25.0), named(30.0)}) == 3
    sources = [pictures(tmp_path / f"v{v}", EVERY[:12], v) for v in (0, 1)]
    late = ImportOptions(pictures=PictureOptions(fps=25.0), range=Range(start=100.0))
    with pytest.raises(InputError, match="no frames between"):
        import_footage(sources, rig, tmp_path / "s", late)
    options = ImportOptions(pictures=PictureOptions(fps=30.0))
    sequence = import_footage(sources, rig, tmp_path / "s", options)
    np.testing.assert_allclose(sequence.times, EVERY[:12], atol=1e-9)


def test_an_edit_needs_an_import_of_the_same_files(tmp_path, rig):
    sequence = of(tmp_path, rig, EVERY, EVERY)
    film(tmp_path / "left.mp4", EVERY[:30])
    with pytest.raises(InputError, match="differs in sources"):
        edit_footage(sequence.folder, ImportOptions(lag=(0.1,)))
    with pytest.raises(FileError, match="no such"):
        edit_footage(tmp_path / "nothing", ImportOptions(lag=(0.1,)))


def test_a_slower_view_is_used_once(tmp_path, rig):
    sequence = of(tmp_path, rig, EVERY, EVERY[::2])
    present = sequence.frame_times.present
    assert present[:, 0].all() and present[:, 1].sum() == 20
    assert all(shows(sequence, i, 1, EVERY[i]) for i in np.flatnonzero(present[:, 1])[:4])


def test_a_part_of_the_footage(tmp_path, rig):
    sequence = of(tmp_path, rig, EVERY, EVERY, ImportOptions(range=Range(start=0.32, end=0.61)))
    np.testing.assert_allclose(sequence.times, EVERY[10:19], atol=2e-5)


def test_a_shorter_view_ends_the_sequence_and_is_named(tmp_path, rig):
    long = np.arange(75) / 30.0
    sequence = of(tmp_path, rig, long, long[:35])
    assert len(sequence) == 35
    assert any(line.startswith("  right ends at 1.13 s") for line in describe(sequence))


def test_a_camera_that_dies_can_be_kept(tmp_path, rig):
    long = np.arange(75) / 30.0
    sequence = of(tmp_path, rig, long, long[:35], ImportOptions(range=Range(keep_single=True)))
    assert len(sequence) == 75 and not sequence.frame_times.present[36:, 1].any()


def test_black_and_frozen_pictures_count_as_missing(tmp_path, rig):
    sequence = of(tmp_path, rig, EVERY, EVERY, shown={
        "left": [*EVERY[:30], *[None] * 10], "right": [*EVERY[:34], *[EVERY[33]] * 6],
    })  # fmt: skip
    present = sequence.frame_times.present
    assert not present[30:, 0].any() and present[:30].all() and len(sequence) <= 34
    assert summary(sequence)["views"]["left"]["black"] == 10


def test_side_by_side_and_folders_of_pictures(tmp_path, rig, caplog):
    import cv2

    folder = tmp_path / "both"
    folder.mkdir()
    for number, time in enumerate(EVERY[:12]):
        both = np.concatenate([scene(time, 0), scene(time, 1)], 1)
        cv2.imwrite(str(folder / f"{number}.png"), both[..., ::-1])
    same = 1.0, 1.0, 1.0
    options = ImportOptions(side_by_side=True, pictures=PictureOptions(fps=30.0), gains=same)
    sequence = import_footage([folder], rig, tmp_path / "s", options)
    np.testing.assert_array_equal(sequence.images(5)[1], scene(EVERY[5], 1))
    apart = [pictures(tmp_path / f"v{v}", EVERY[:12], v) for v in (0, 1)]
    options = ImportOptions(pictures=PictureOptions(fps=30.0), gains=same)
    sequence = import_footage(apart, rig, tmp_path / "t", options)
    np.testing.assert_array_equal(sequence.images(5)[1], scene(EVERY[5], 1))
    assert "begin with" not in caplog.text
    next(iter(sorted(apart[1].iterdir()))).unlink()
    import_footage(apart, rig, tmp_path / "u", options)
    assert "the pictures begin with v0/" in caplog.text


def test_the_rig_is_scaled_to_the_pictures(tmp_path, rig):
    sequence = of(tmp_path, rig.resized(640, 480), EVERY, EVERY)
    camera = sequence.rig.cameras[0]
    assert (camera.width, camera.height) == (64, 48)
    assert camera == rig.resized(640, 480).cameras[0].resized(64, 48)


def test_another_aspect_ratio_is_refused_with_both_sizes(tmp_path, rig):
    with pytest.raises(FileError, match=r"64 x 48 .*'left'.*640 x 512"):
        of(tmp_path, rig.resized(640, 512), EVERY, EVERY)


def test_no_common_time_is_refused(tmp_path, rig):
    with pytest.raises(InputError, match="no time in common"):
        of(tmp_path, rig, EVERY, EVERY, ImportOptions(lag=(60.0,)))


def test_wrong_sources_are_refused(tmp_path, rig):
    path = film(tmp_path / "left.mp4", EVERY)
    with pytest.raises(InputError, match=r"1 sources .*valid: 2: left, right"):
        import_footage([path], rig, tmp_path / "s")
    with pytest.raises(InputError, match="same source twice"):
        import_footage([path, path], rig, tmp_path / "s")
    with pytest.raises(FileError, match="no such file"):
        import_footage([path, tmp_path / "right.mp4"], rig, tmp_path / "s")


def test_an_interrupted_copy_is_completed(tmp_path, rig):
    whole = of(tmp_path, rig, np.arange(120) / 30, np.arange(120) / 30, ImportOptions(copy=True))
    manifest = json.loads((whole.folder / "manifest.json").read_text())
    (whole.folder / manifest["shards"].pop()["name"]).unlink()
    kept = (whole.folder / "shard-00000.tar").stat().st_mtime_ns
    (whole.folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(FileError, match="run the same import command again"):
        Sequence(whole.folder)
    sources = [tmp_path / "left.mp4", tmp_path / "right.mp4"]
    again = import_footage(sources, rig, whole.folder, ImportOptions(copy=True))
    assert shows(again, 119, 1, 119 / 30)
    assert (whole.folder / "shard-00000.tar").stat().st_mtime_ns == kept
    with pytest.raises(InputError, match="another sequence"):
        import_footage(sources, rig, whole.folder, ImportOptions(copy=True, lag=(0.1,)))


def test_an_import_that_ends_meanwhile_is_kept(tmp_path, rig, monkeypatch):
    out, options = tmp_path / "sequence", ImportOptions(copy=True)
    sources = [film(tmp_path / f"{v}.mp4", EVERY, v) for v in (0, 1)]
    pair = importing.pair

    def after_another_process(*words):
        monkeypatch.setattr(importing, "pair", pair)
        import_footage(sources, rig, out, options)
        return pair(*words)

    monkeypatch.setattr(importing, "pair", after_another_process)
    assert len(import_footage(sources, rig, out, options)) == 40
    assert (out / "manifest.json").exists()


def test_a_folder_that_lost_a_picture_is_refused(tmp_path, rig):
    sources = [pictures(tmp_path / name, EVERY[:12], v) for v, name in enumerate(rig.views)]
    options = ImportOptions(pictures=PictureOptions(fps=30.0), gains=(1.0, 1.0, 1.0))
    sequence = import_footage(sources, rig, tmp_path / "s", options)
    np.testing.assert_array_equal(sequence.images(5)[0], scene(EVERY[5], 0))
    (tmp_path / "left" / "0003.png").unlink()
    with pytest.raises(FileError, match="left: is not as it was imported"):
        Sequence(sequence.folder).images(5)


@pytest.mark.parametrize("keep_single", [False, True])
def test_a_view_without_usable_pictures_is_named(tmp_path, rig, keep_single):
    options = ImportOptions(range=Range(keep_single=keep_single))
    with pytest.raises(InputError, match="'right' has no usable picture"):
        of(tmp_path, rig, EVERY, EVERY, options, shown={"right": [None] * 40})
