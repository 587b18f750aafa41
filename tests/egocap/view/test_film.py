"""The film has the viewer's layout: space to the left, views and a curve to the right."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from egocap.body.side_colours import LEFT, RIGHT
from egocap.data.head_pose import HeadPoses, in_world
from egocap.data.sequence import Sequence
from egocap.data.track import load_track, save_track
from egocap.detect.sources import synthetic_detections
from egocap.errors import InputError
from egocap.media.source import open_source
from egocap.track.tracker import Tracker
from egocap.view.film import CURVE_HEIGHT, HEIGHT, FilmPictures
from egocap.view.skeleton import GREY
from egocap.view.viewer import view


@pytest.fixture(scope="module")
def track(tiny_sequence, tmp_path_factory):
    """A track of the sequence."""
    sequence = Sequence(tiny_sequence)
    found = Tracker(sequence.rig, sequence.body).track(synthetic_detections(sequence))
    path = tmp_path_factory.mktemp("film") / "track.npz"
    save_track(path, found)
    return path


def count(image, colour) -> int:
    return int((np.abs(image.astype(int) - colour).sum(-1) < 40).sum())


def test_a_picture_shows_space_views_and_where_the_curve_is(tiny_sequence, track):
    sequence = Sequence(tiny_sequence)
    pictures = FilmPictures(sequence, load_track(track))
    first, last = pictures.draw(0), pictures.draw(len(sequence) - 1)
    assert first.shape == last.shape == (840, 840 + 450, 3)  # two views of 360 rows, 5 to 4
    space, side = first[:, :HEIGHT], first[:-CURVE_HEIGHT, HEIGHT:]
    for colour in (LEFT, RIGHT, GREY):  # the truth is grey
        assert count(space, colour) > 100 and count(side, colour) > 20
    curve = slice(-CURVE_HEIGHT + 30, None), slice(HEIGHT, None)
    marked = [np.argwhere((image[curve] == (240, 228, 66)).all((0, 2))) for image in (first, last)]
    assert marked[0].max() <= 1 and marked[1].min() >= 447  # columns, of 450


def test_a_track_in_the_world_walks_over_its_floor_among_the_surroundings(
    tiny_sequence, track, monkeypatch
):
    sequence, found = Sequence(tiny_sequence), load_track(track)
    T = np.tile(np.eye(4), (len(found.times), 1, 1))
    T[:, :3, 3] = np.linspace([3.0, -2.0, 1.6], [3.5, -2.0, 1.6], len(T))
    placed = in_world(found, HeadPoses(T, np.ones(len(T), bool)))
    contacts = np.tile([0.9, 0.2, 0.1, 0.1], (len(T), 1))
    # one point, seen in two visits, and one that is far
    behind = np.array([[1.02, -0.98, 1.02], [1.04, -0.98, 1.02], [12.0, 7.0, 1.0]])
    pictures = FilmPictures(sequence, replace(placed, contacts=contacts), behind)
    last = pictures.draw(len(T) - 1)[:, :HEIGHT]
    bare = FilmPictures(sequence, placed).draw(len(T) - 1)[:, :HEIGHT]
    for colour in (LEFT, RIGHT, GREY):  # the truth is grey
        assert count(bare, colour) > 100
    ring, points = (240, 228, 66), (118, 128, 148)
    assert count(last, ring) > 50 and count(bare, ring) == 0
    assert int((last == points).all(-1).sum()) == 4 and not (bare == points).all(-1).any()
    monkeypatch.setattr("egocap.view.film._WAY_S", 0.0)
    still = pictures.draw(len(T) - 1)[:, :HEIGHT]
    assert count(last, (170, 170, 170)) > count(still, (170, 170, 170)) + 20  # the way on the floor


def test_view_saves_a_film_without_the_viewer(tiny_sequence, track, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    view([tiny_sequence, track], tmp_path / "film.mp4")
    film = open_source(tmp_path / "film.mp4")
    assert film.size[1] == HEIGHT and len(film.times) == 4  # of 7 frames at 30 Hz
    with pytest.raises(InputError, match="one sequence and one track"):
        view([track], tmp_path / "none.mp4")
    found = load_track(track)
    save_track(tmp_path / "late.npz", replace(found, times=found.times + 1.0))
    with pytest.raises(InputError, match="different times"):
        view([tiny_sequence, tmp_path / "late.npz"], tmp_path / "none.mp4")
    assert not (tmp_path / "none.mp4").exists()
