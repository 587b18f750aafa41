"""Pictures in, points in the rig's pixels out: geometry by an engine that reads colours."""

import json
import logging
import shutil
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from egocap.body.labels import MIRROR
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.data.detections import load_detections, save_detections
from egocap.data.sequence import Sequence
from egocap.detect.calibration import Calibration
from egocap.detect.canonical_view import CanonicalView, ViewSpec
from egocap.detect.detector import MODES, Detector, joined, missing_pictures
from egocap.detect.engine import Engine
from egocap.detect.weights import Weights, open_weights
from egocap.errors import FileError, InputError

STRIDE, SPEC = 4, ViewSpec()
COLOURS = np.array([[60 + 90 * (i % 3), 60 + 90 * (i // 3 % 3), 60 + 90 * (i // 9)]
                    for i in range(18)])  # fmt: skip
ABSENT = 7  # a label that the engine below says is out of view


def read_colours(images):
    """Heat about the middle of every label's colour in canonical views; flat where there is none.

    The network does not know that a view is mirrored: it calls what looks left left.
    """
    h, w = SPEC.height // STRIDE, SPEC.width // STRIDE
    rows, columns = np.mgrid[:h, :w]
    heat = np.zeros((len(images), 18, h, w), np.float32)
    info = np.zeros((len(images), 18, 4), np.float32)
    info[..., 0], info[..., 3] = 4.0, np.log(1.5)
    info[:, ABSENT, 2] = 9.0
    for image, maps in zip(images.astype(int), heat, strict=True):
        for label, colour in enumerate(COLOURS):
            pieces, count = ndimage.label(np.abs(image - colour).max(-1) < 30)
            if count:  # the largest: borders of other dots may have the colour too
                y, x = np.nonzero(pieces == np.bincount(pieces.flat)[1:].argmax() + 1)
                at = ((y.mean() + 0.5) / STRIDE - 0.5, (x.mean() + 0.5) / STRIDE - 0.5)
                maps[label] = -((rows - at[0]) ** 2 + (columns - at[1]) ** 2)
    return heat, info


@pytest.fixture(scope="module")
def rig() -> Rig:
    path = Path(__file__).parents[3] / "scenes/rigs/egorig1.toml"
    return load_rig(path).resized(640, 512)


@pytest.fixture(scope="module")
def detector(rig: Rig) -> Detector:
    config = {"name": "colours"}
    weights = Weights(Path("none"), "0" * 64, config, SPEC, STRIDE, Calibration(), {})
    return Detector(rig, weights, Engine("colours", read_colours))


def painted(rig, size=(640, 512), seed=0):
    """A picture of every view with a dot of each label's colour, and where the dots are.

    Dots lie on a grid of the canonical view, so that every one is seen; places are in pixels of the
    rig's own size.
    """
    rng = np.random.default_rng(seed)
    pictures, places = [], np.zeros((len(rig.mounts), 18, 2))
    for v, mount in enumerate(rig.mounts):
        view = CanonicalView(mount, SPEC)
        spots = np.array([[70 + 25 * (i % 5), 70 + 25 * (i // 5)] for i in range(18)], float)
        spots, seen = view.to_camera(spots + rng.uniform(-3, 3, (18, 2)))
        assert seen.all()
        places[v] = spots
        scale = size[0] / mount.camera.width
        picture = np.zeros((size[1], size[0], 3), np.uint8)
        for label, (px, py) in enumerate((spots + 0.5) * scale - 0.5):
            colour = COLOURS[MIRROR[label] if view.mirrored else label]
            y, x = np.mgrid[int(py) - 30 : int(py) + 31, int(px) - 30 : int(px) + 31]
            inside = np.hypot(x - px, y - py) <= 9 * scale
            picture[y[inside], x[inside]] = colour
        pictures.append(picture)
    return pictures, places


def test_points_lie_where_the_dots_are_in_both_views(detector, rig):
    pictures, places = painted(rig)
    found = detector.detect_images(pictures, 2.5)
    assert found.times.tolist() == [2.5]
    assert np.array_equal(np.argwhere(~found.valid[0]), [[0, ABSENT], [1, MIRROR[ABSENT]]])
    off = np.linalg.norm(found.points[0] - places, axis=-1)[found.valid[0]]
    assert off.max() < 1.2 and off.mean() < 0.5
    assert np.isnan(found.points[~found.valid]).all()


def test_labels_change_sides_in_the_mirrored_view(detector, rig):
    found = detector.detect_images(painted(rig)[0])
    assert [CanonicalView(m, SPEC).mirrored for m in rig.mounts] == [False, True]
    assert not found.valid[0, 0, ABSENT] and found.valid[0, 0, MIRROR[ABSENT]]
    assert not found.valid[0, 1, MIRROR[ABSENT]] and found.valid[0, 1, ABSENT]


@pytest.mark.parametrize("size", [(320, 256), (1280, 1024), (641, 513)])
def test_other_sizes_of_the_same_aspect(detector, rig, size):
    found = detector.detect_images(painted(rig, size)[0])
    off = np.linalg.norm(found.points[0] - painted(rig)[1], axis=-1)[found.valid[0]]
    assert found.valid.sum() == 34
    assert off.max() < 2.0 and off.mean() < 0.8


def test_other_aspects_and_numbers_are_refused(detector, rig):
    black = np.zeros((480, 640, 3), np.uint8)
    with pytest.raises(
        InputError, match=r"640 x 480 for the view 'left'.*aspect ratio of 640 x 512"
    ):
        detector.detect_images([black, black])
    with pytest.raises(InputError, match="3 pictures of a rig of 2 views"):
        detector.detect_images([None] * 3)


def test_a_missing_view_leaves_the_other_as_it_is(detector, rig):
    pictures, _ = painted(rig)
    both, one = detector.detect_images(pictures), detector.detect_images([None, pictures[1]])
    assert not one.valid[0, 0].any() and (one.confidence[0, 0] == 0).all()
    assert np.array_equal(one.points[0, 1], both.points[0, 1], equal_nan=True)
    assert missing_pictures(one) == [1, 0]
    none = detector.detect_images([None, None])
    assert not none.valid.any()


def test_a_batch_equals_single_frames(detector, rig):
    pictures, times = [painted(rig, seed=i)[0] for i in range(2)], 0.1 * np.arange(2)
    views, slots = detector.canonical(pictures)
    batch = detector.read(detector.run(views), slots, times)
    for i, images in enumerate(pictures):
        one = detector.detect_images(images, times[i])
        assert one.times[0] == batch.times[i]
        assert np.allclose(batch.points[i], one.points[0], equal_nan=True)
        assert np.allclose(batch.mode_weights[i], one.mode_weights[0])


def test_spread_follows_the_lens(detector, rig):
    found = detector.detect_images(painted(rig)[0])
    for v, mount in enumerate(rig.mounts):
        view = CanonicalView(mount, SPEC)
        points, _ = view.to_view(found.points[0, v])
        expected = 1.5 * view.magnification(points)
        ok = found.valid[0, v]
        assert np.allclose(found.sigma[0, v][ok], expected[ok], rtol=1e-3)
    expected = 1.0 / (1.0 + 2.0 * np.exp(-4.0))
    assert np.allclose(found.confidence[found.valid], expected, atol=1e-6)


def test_modes_are_kept_and_survive_the_disk(detector, rig, tmp_path):
    pictures, _ = painted(rig)
    left = CanonicalView(rig.mounts[0], SPEC)
    second = detector.detect_images(pictures)

    def two_places(images):
        heat, info = read_colours(images)
        return np.logaddexp(heat, np.roll(heat, 12, axis=-1) - 0.7), info

    engine = Engine("two", two_places)
    found = Detector(rig, detector.weights, engine).detect_images(pictures)
    assert found.modes.shape == (1, 2, 18, MODES, 2)
    assert np.allclose(found.modes[..., 0, :], found.points, equal_nan=True)
    weights = found.mode_weights[0, 0][found.valid[0, 0]]
    assert (weights.sum(-1) <= 1 + 1e-6).all() and (weights[:, 0] > weights[:, 1]).all()
    assert weights[:, 1].min() > 0.25
    shifted, _ = left.to_view(found.modes[0, 0, 0, :2])
    assert shifted[1] - shifted[0] == pytest.approx([12 * STRIDE, 0], abs=1.0)
    assert np.abs(second.points - found.points)[found.valid].max() < 3
    save_detections(tmp_path / "d.npz", found)
    again = load_detections(tmp_path / "d.npz")
    assert np.array_equal(again.mode_weights, found.mode_weights)


def test_sequences_are_detected_frame_by_frame(tiny_sequence, tiny_file, caplog):
    sequence = Sequence(tiny_sequence)
    detector = Detector(sequence.rig, open_weights(tiny_file), threads=1)
    advanced = []
    found = detector.detect(sequence, batch=3, on_frames=advanced.append)
    assert advanced == [3, 3, 1]
    assert np.array_equal(found.times, sequence.times)
    assert found.source == f"learned:{detector.weights.name}"
    single = joined([detector.detect_images(f.images, f.time) for f in sequence])
    assert np.array_equal(found.valid, single.valid)
    assert np.allclose(found.points, single.points, atol=0.05, equal_nan=True)
    assert len(detector.detect(sequence, frames=2).times) == 2
    with pytest.raises(InputError, match=r"8 frames.*1 to 7"):
        detector.detect(sequence, frames=8)


def test_frames_stay_in_order_when_several_are_detected_at_once(tiny_sequence, tiny_file):
    sequence, weights = Sequence(tiny_sequence), open_weights(tiny_file)
    alone = Detector(sequence.rig, weights, "onnxruntime", threads=2, streams=1)
    expected = alone.detect(sequence)
    delays, running, most = iter((0.2, 0.0, 0.1, 0.0, 0.05, 0.0, 0.0)), [], []

    def late(images):
        running.append(1)
        most.append(len(running))
        time.sleep(next(delays))
        outputs = alone.engine.run(images)
        running.pop()
        return outputs

    for engine in (Engine("late", late, streams=2), "onnxruntime"):
        found = Detector(sequence.rig, weights, engine, threads=2).detect(sequence)
        assert np.array_equal(found.times, expected.times)
        assert np.allclose(found.points, expected.points, atol=0.05, equal_nan=True)
    assert max(most) == 2


def test_frames_without_a_view_are_counted(tiny_sequence, tiny_file, tmp_path, caplog):
    folder = tmp_path / "one-eyed"
    shutil.copytree(tiny_sequence, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["shards"][1]["frames"][0]["left.jpg"]  # frame 2
    (folder / "manifest.json").write_text(json.dumps(manifest))
    whole, half = Sequence(tiny_sequence), Sequence(folder)
    weights = open_weights(tiny_file)
    with caplog.at_level(logging.WARNING):
        found = Detector(half.rig, weights, threads=1).detect(half)
    assert "view 'left' has no detections in 1 of 7 frames" in caplog.text
    expected = Detector(whole.rig, weights, threads=1).detect(whole)
    assert not found.valid[2, 0].any()
    assert np.array_equal(found.valid[2, 1], expected.valid[2, 1])
    assert np.array_equal(found.valid[3:], expected.valid[3:])


def test_a_damaged_picture_is_a_file_error(tiny_sequence, tiny_file, monkeypatch):
    sequence = Sequence(tiny_sequence)
    read = Sequence.read
    broken = lambda self, i, suffix: b"" if i == 4 else read(self, i, suffix)  # noqa: E731
    monkeypatch.setattr(Sequence, "read", broken)
    detector = Detector(sequence.rig, open_weights(tiny_file), threads=1)
    with pytest.raises(FileError, match="frame 4"):
        detector.detect(sequence)


def test_one_camera_is_enough(detector, rig):
    alone = Detector(replace(rig, mounts=rig.mounts[1:]), detector.weights, detector.engine)
    pictures, _ = painted(rig)
    found, both = alone.detect_images(pictures[1:]), detector.detect_images(pictures)
    assert np.array_equal(found.points[0, 0], both.points[0, 1], equal_nan=True)
