"""Detections and tracks on disk: exact round trips, and an error for every kind of damage."""

import contextlib
import dataclasses
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.data.arrays import SCHEMA
from egocap.data.detections import Detections, load_detections, save_detections
from egocap.data.track import Track, load_track, save_track
from egocap.errors import FileError, MachineError


def make_detections(frames=4, views=2):
    rng = np.random.default_rng(0)
    shape = (frames, views, 18)
    valid = rng.random(shape) < 0.7
    points = np.where(valid[..., None], rng.random((*shape, 2)) * 500, np.nan)
    return Detections(
        np.arange(frames) / 30, points, np.full(shape, 2.0), valid * 1.0, valid, "simulated:2.0"
    )


def make_modes(frames=4, modes=3):
    """Detections with a few modes each, fewer for some joints."""
    made = make_detections(frames)
    rng = np.random.default_rng(2)
    weights = np.sort(rng.dirichlet(np.ones(modes), made.valid.shape))[..., ::-1].copy()
    weights[..., -1] = 0.0
    places = np.where(weights[..., None] > 0, rng.random((*weights.shape, 2)) * 500, np.nan)
    return dataclasses.replace(made, modes=places, mode_weights=weights)


def make_track(frames=4):
    rng = np.random.default_rng(1)
    return Track(
        times=np.arange(frames) / 30,
        angles=rng.normal(size=(frames, 37)),
        joints_head=rng.normal(size=(frames, 18, 3)),
        energy=rng.random(frames),
        converged=np.ones(frames, bool),
        detections_used=np.full(frames, 20.0),
        seconds_per_frame=0.002,
        config={"tracker": {"zeta": 0.25}, "detections": "simulated:2.0"},
    )


def make_explained(frames=4):
    """A track that says why joints are hidden."""
    causes = np.random.default_rng(3).integers(0, 4, (frames, 2, 18)).astype(np.uint8)
    return dataclasses.replace(make_track(frames), hidden=causes)


KINDS = [
    (make_explained, save_track, load_track),
    (make_detections, save_detections, load_detections),
    (make_modes, save_detections, load_detections),
    (make_track, save_track, load_track),
]


def rewritten(path, **changes):
    """The file with arrays replaced; None removes one."""
    with np.load(path) as archive:
        arrays = dict(archive) | changes
    np.savez(path, **{k: v for k, v in arrays.items() if v is not None})
    return path


@pytest.mark.parametrize(("make", "save", "load"), KINDS)
def test_round_trip(tmp_path, make, save, load):
    result = make()
    path = tmp_path / "result.npz"
    save(path, result)
    again = load(path)
    for field in dataclasses.fields(result):
        a, b = getattr(result, field.name), getattr(again, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
        else:
            assert a == b
    assert [p.name for p in tmp_path.iterdir()] == ["result.npz"]


def test_causes_are_known_ones(tmp_path):
    track = make_explained()
    save_track(tmp_path / "t.npz", dataclasses.replace(track, hidden=track.hidden + 3))
    with pytest.raises(FileError, match=r"key 'hidden'.*valid: 0 to 3"):
        load_track(tmp_path / "t.npz")
    rewritten(tmp_path / "t.npz", hidden=track.hidden.astype(float))
    with pytest.raises(FileError, match="whole numbers"):
        load_track(tmp_path / "t.npz")


def test_one_kind_is_not_taken_for_the_other(tmp_path):
    save_track(tmp_path / "t.npz", make_track())
    with pytest.raises(FileError, match=r"egocap-track.*valid: egocap-detections"):
        load_detections(tmp_path / "t.npz")


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"angles": None}, "angles.*missing"),
        ({"angles": np.zeros((4, 36))}, "angles.*(4, 37)"),
        ({"angles": np.zeros((5, 37))}, "angles.*(4, 37)"),
        ({"angles": np.zeros(4)}, "angles"),
        ({"angles": np.zeros((4, 37), int)}, "angles.*int"),
        ({"angles": np.full((4, 37), np.nan)}, "angles.*finite"),
        ({"converged": np.ones(4)}, "converged.*booleans"),
        ({"config": np.array("{")}, "config.*JSON"),
        ({"config": np.array("[1]")}, "config.*object"),
        ({"extra": np.zeros(1)}, "extra.*unknown"),
        ({"schema_version": np.array(SCHEMA + 1)}, "newer"),
        ({"schema_version": np.array("one")}, "schema_version"),
        ({"kind": None}, "kind"),
    ],
)
def test_bad_content_names_the_array(tmp_path, changes, says):
    path = tmp_path / "t.npz"
    save_track(path, make_track())
    with pytest.raises(FileError, match=says):
        load_track(rewritten(path, **changes))


def test_a_track_without_a_frame_is_refused(tmp_path):
    track = make_track()
    empty = {name: array[:0] for name, array in track.by_frame.items()}
    save_track(tmp_path / "t.npz", dataclasses.replace(track, **empty))
    with pytest.raises(FileError, match=r"t\.npz, key 'times': holds no frame"):
        load_track(tmp_path / "t.npz")


def test_views_must_agree(tmp_path):
    path = tmp_path / "d.npz"
    save_detections(path, make_detections())
    with pytest.raises(FileError, match="valid"):
        load_detections(rewritten(path, valid=np.ones((4, 3, 18), bool)))


@pytest.mark.parametrize(
    ("name", "value"), [("points", np.nan), ("sigma", -1.0), ("sigma", np.inf), ("confidence", 2.0)]
)
def test_impossible_detections_name_array_frame_and_view(tmp_path, name, value):
    path = tmp_path / "d.npz"
    made = make_detections()
    save_detections(path, made)
    frame, view, joint = np.argwhere(made.valid)[5]
    array = getattr(made, name).copy()
    array[frame, view, joint] = value
    with pytest.raises(FileError, match=f"'{name}'.* {joint} in view {view} of frame {frame}"):
        load_detections(rewritten(path, **{name: array}))


def test_files_from_before_modes_are_read(tmp_path):
    path = tmp_path / "d.npz"
    made = make_detections()
    save_detections(path, made)
    again = load_detections(rewritten(path, schema_version=np.array(1)))
    assert again.modes is None
    points, weights = again.candidates
    assert np.array_equal(points[..., 0, :], made.points, equal_nan=True)
    assert np.array_equal(weights[..., 0], made.valid)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda modes, weights: {"modes": None}, "both or none"),
        (lambda modes, weights: {"modes": np.full_like(modes, np.nan)}, "'modes'.*finite pixels"),
        (lambda modes, weights: {"modes": np.full_like(modes, 1e200)}, "'modes'.*finite pixels"),
        (lambda modes, weights: {"mode_weights": 2 * weights}, "'mode_weights'.*adding up to 1"),
        (lambda modes, weights: {"mode_weights": weights - 0.5}, "'mode_weights'.*0 or more"),
        (lambda modes, weights: {"modes": modes[..., :1, :]}, r"mode_weights.*\(4, 2, 18, 1\)"),
    ],
)
def test_impossible_modes_are_refused(tmp_path, change, says):
    path, made = tmp_path / "d.npz", make_modes()
    save_detections(path, made)
    with pytest.raises(FileError, match=says):
        load_detections(rewritten(path, **change(made.modes, made.mode_weights)))


def test_pickles_are_never_opened(tmp_path):
    path = tmp_path / "t.npz"
    save_track(path, make_track())
    with pytest.raises(FileError, match="plain arrays"):
        load_track(rewritten(path, angles=np.array([{"a": 1}], dtype=object)))


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        load_track(tmp_path / "none.npz")
    with pytest.raises(FileError, match="is a folder"):
        load_track(tmp_path)


def test_other_archives_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "t.npz", "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(FileError):
        load_track(tmp_path / "t.npz")
    np.save(tmp_path / "a.npy", np.zeros(3))
    with pytest.raises(FileError):
        load_track(tmp_path / "a.npy")


@settings(deadline=None, max_examples=60)
@given(
    cut=st.floats(0, 1),
    flips=st.lists(st.tuples(st.floats(0, 0.999), st.integers(1, 255)), max_size=4),
)
def test_any_damage_is_a_file_error_or_harmless(tmp_path_factory, cut, flips):
    path = tmp_path_factory.mktemp("damage") / "t.npz"
    save_track(path, make_track(2))
    data = bytearray(path.read_bytes())
    for place, bits in flips:
        data[int(place * len(data))] ^= bits
    path.write_bytes(bytes(data[: int(np.ceil(cut * len(data)))] if cut < 0.999 else data))
    with contextlib.suppress(FileError):
        load_track(path)


def test_unwritable_place_is_a_machine_error(tmp_path):
    with pytest.raises(MachineError, match="cannot write"):
        save_track(tmp_path / "no" / "such" / "t.npz", make_track())


def test_some_frames_of_detections():
    shape = (5, 2, 18)
    found = Detections(
        np.arange(5.0), np.arange(360.0).reshape(*shape, 2), np.ones(shape), np.ones(shape),
        np.ones(shape, bool), "made up", np.zeros((*shape, 3, 2)), np.zeros((*shape, 3)),
    )  # fmt: skip
    part = found[1:3]
    assert part.times.tolist() == [1.0, 2.0] and part.source == "made up"
    np.testing.assert_array_equal(part.points, found.points[1:3])
    assert part.modes.shape == (2, 2, 18, 3, 2) and part.mode_weights.shape == (2, 2, 18, 3)
    assert len(found[-1:].times) == 1 and found[:2].modes is not None
