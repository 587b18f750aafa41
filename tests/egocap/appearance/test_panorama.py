"""What is known of the room behind the body, by direction."""

import numpy as np
import pytest

from egocap.appearance.panorama import Panorama
from egocap.geometry import exponential
from egocap.image_model.colour_measure import rgb_to_hsv
from egocap.image_model.image_rays import ray_colours
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import ColourBins, ColourCounts, Palette, learn_palette
from tests.egocap.image_model.test_palette import BLUE, BODY, GREY, POSE, RAYS, picture

BINS = ColourBins(20, 24)
OPEN, COVERED = np.zeros(len(RAYS), np.float32), np.ones(len(RAYS), np.float32)
BROWN = (0.07, 0.6, 0.4)
CHEST = BODY.parts.index("chest")


def palette(own=BLUE):
    """Every Gaussian in one colour."""
    counts = ColourCounts(BODY, BINS)
    counts.add(np.ones((len(RAYS), len(BODY.parts)), np.float32), BINS.of(even(own)))
    return Palette(counts.log_density())


def even(colour):
    return np.tile(np.float32(colour), (len(RAYS), 1))


def halves(left, right, directions=RAYS.direction):
    """One colour to the left of the head, another to its right."""
    side = directions[:, 1] > 0.0
    return np.where(side[:, None], np.float32(left), np.float32(right)).astype(np.float32), side


def seen(panorama, colours, frames=4):
    for _ in range(frames):
        panorama.update(colours, OPEN)
    return panorama


def test_a_hand_of_the_floors_colour_is_told_from_what_lies_behind_it():
    """Blue before grey, in a room whose other half is as blue as the person."""
    room, blue_side = halves(BLUE, GREY)
    panorama = seen(Panorama(RAYS, BINS), room)
    unlike = panorama.compare(palette(), even(BLUE)).unlike[CHEST]
    assert (unlike[~blue_side] < -0.5).mean() > 0.95
    assert (np.abs(unlike[blue_side]) < 0.6).mean() > 0.95
    assert (panorama.compare(palette(), even(GREY)).unlike[CHEST][~blue_side] > 0.9).mean() > 0.95


def test_the_room_stays_where_it_is_as_the_rig_turns():
    turn = exponential(np.array([0.0, 0.0, np.pi]))
    panorama = seen(Panorama(RAYS, BINS), halves(BLUE, BROWN)[0])
    for _ in range(4):
        panorama.turn(exponential(np.array([0.0, 0.0, np.pi / 4])))
    settled = np.abs(RAYS.direction[:, 1]) > 0.1
    for colours, blue, known in (
        (*halves(BLUE, BROWN, RAYS.direction @ turn), True),
        (*halves(BLUE, BROWN), False),
    ):
        unlike = panorama.compare(palette(), colours).unlike[CHEST][settled & blue]
        assert (np.abs(unlike) < 0.6 if known else unlike < -0.6).mean() > 0.9


def test_covered_rays_and_strange_colours_change_little():
    panorama = seen(Panorama(RAYS, BINS), even(GREY), 10)
    before = panorama.compare(palette(), even(GREY)).unlike
    panorama.update(even(BLUE), COVERED)
    assert np.allclose(panorama.compare(palette(), even(GREY)).unlike, before, atol=0.05)
    panorama.update(even(BLUE), OPEN)
    assert (panorama.compare(palette(), even(GREY)).unlike[CHEST] > 0.9).mean() > 0.95
    for _ in range(200):
        panorama.update(even(BLUE), OPEN)
    assert (panorama.compare(palette(), even(BLUE)).unlike[CHEST] > -0.6).mean() > 0.95


def test_what_is_fixed_to_the_rig_is_known_wherever_it_turns():
    """A part of the rig as blue as the person, in a brown room."""
    colours, part = halves(BLUE, BROWN)
    panorama = Panorama(RAYS, BINS)
    for _ in range(8):
        panorama.turn(exponential(np.array([0.0, 0.0, np.pi / 5])))
        panorama.update(colours, OPEN)
    unlike = panorama.compare(palette(), even(BLUE)).unlike[CHEST]
    assert (unlike[part] > -0.6).mean() > 0.9
    assert (unlike[~part] < -0.6).mean() > 0.9


def test_a_pixel_that_moves_is_not_taken_for_the_background():
    panorama = seen(Panorama(RAYS, BINS), even(BLUE))
    moved = np.where(RAYS.view == 0, 3.0, 0.0)
    still, moving = (
        panorama.compare(palette(), even(BLUE), m).unlike[CHEST] for m in (None, moved)
    )
    assert (moving[RAYS.view == 0] == -1.0).all()
    assert np.array_equal(moving[RAYS.view == 1], still[RAYS.view == 1])


def test_the_light_is_told_from_the_background_and_does_not_drift():
    rng = np.random.default_rng(5)
    rgb = rng.uniform(0.2, 0.5, (len(RAYS), 3))
    panorama, gain = seen(Panorama(RAYS, BINS), hsv(rgb)), np.array([1.5, 1.2, 0.9])
    assert panorama.light(hsv(rgb), COVERED) is None
    for _ in range(20):
        change = panorama.light(hsv(rgb * gain), OPEN)
        assert change is not None and np.allclose(change, gain, rtol=0.15)
        panorama.update(hsv(rgb * gain / change), OPEN)


def hsv(rgb):
    return rgb_to_hsv(rgb).astype(np.float32)


def test_finer_bins_part_what_coarse_ones_do_not():
    skin, wood = np.float32([[0.06, 0.55, 0.60]]), np.float32([[0.06, 0.55, 0.52]])
    coarse = ColourBins()
    assert coarse.of(skin) == coarse.of(wood)
    assert BINS.of(skin) != BINS.of(wood)
    assert BINS.of(skin)[0] < BINS.count
    assert np.allclose(2.0 * coarse.coordinates(skin), BINS.coordinates(skin))


def test_counts_learn_what_the_palette_learns_and_some_rows_of_it():
    image = picture(GREY)
    whole = learn_palette(BODY, RAYS, [(image, POSE)]).log_density
    counts, visibility = ColourCounts(BODY), ImageModel(BODY, RAYS).visibility(POSE)
    counts.add(visibility, counts.bins.of(ray_colours(RAYS, image)))
    some = counts.pixels > 1.0
    assert 5 < some.sum() < 91
    assert np.array_equal(counts.log_density(), whole)
    assert np.array_equal(counts.log_density(some), whole[some])
    before = counts.pixels
    counts.add(visibility, counts.bins.of(ray_colours(RAYS, image)), some)
    assert counts.pixels == pytest.approx(np.where(some, 2.0 * before, before))
