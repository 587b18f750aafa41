"""Points move with pixels, shading survives recolouring, and the wearer every background."""

import numpy as np
import pytest

from egocap.detect.train.augmentation import (
    WEARER,
    aberrated,
    augment,
    camouflaged,
    exposed,
    flared,
    greyed,
    moved,
    occluded,
    recoloured,
    replaced_background,
    rimmed,
    toned,
)
from egocap.detect.train.config import NO_AUGMENTATION, AugmentationConfig
from egocap.detect.train.examples import HIDDEN, OUTSIDE, SEEN, Example

SHAPE = (224, 256)


def marked(points: np.ndarray) -> np.ndarray:
    """A soft blob at each point; the k-th in channel k."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    blobs = [np.exp(-((u - x) ** 2 + (v - y) ** 2) / 18.0) for x, y in points[:3]]
    return np.rint(255 * np.stack(blobs, -1)).astype(np.uint8)


def centres(image: np.ndarray) -> np.ndarray:
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    weight = image.astype(float)
    total = weight.sum((0, 1))
    return (
        np.stack([(u[..., None] * weight).sum((0, 1)), (v[..., None] * weight).sum((0, 1))]).T
        / (total[:, None])
    )


@pytest.mark.parametrize("seed", range(6))
def test_points_move_with_pixels(seed):
    points = np.zeros((18, 2))
    points[:3] = (90.0, 80.0), (150.0, 100.0), (120.0, 140.0)
    image, after, state = moved(
        marked(points), points, np.full(18, SEEN, np.uint8), AugmentationConfig(),
        np.random.default_rng(seed),
    )  # fmt: skip
    np.testing.assert_allclose(centres(image), after[:3], atol=0.15)
    assert not np.allclose(after[:3], points[:3], atol=1.0)
    assert (state[:3] == SEEN).all()


def test_what_leaves_the_image_is_outside():
    points = np.tile([254.0, 2.0], (18, 1))
    states = [
        moved(np.zeros((*SHAPE, 3), np.uint8), points, np.full(18, HIDDEN, np.uint8),
              AugmentationConfig(), np.random.default_rng(s))[2][0]
        for s in range(20)
    ]  # fmt: skip
    assert set(states) == {HIDDEN, OUTSIDE}


def test_recolouring_keeps_shading_and_everything_else():
    rng = np.random.default_rng(0)
    parts = np.full(SHAPE, 100, np.uint8)
    parts[50:150, 50:150] = 3  # chest
    image = np.full((*SHAPE, 3), 90, np.uint8)
    image[:, :, :] = np.linspace(30, 60, SHAPE[1])[None, :, None]  # shading
    changed = 0
    for _ in range(8):
        new = recoloured(image, parts, rng).astype(float)
        np.testing.assert_array_equal(new[parts == 100], image[parts == 100])
        ratio = new[100, 55:145] / image[100, 55:145]
        assert (ratio.std(0) / ratio.mean(0) < 0.05).all()  # one factor a channel, to rounding
        changed += not np.allclose(ratio.mean(0), 1.0, atol=0.02)
    assert changed >= 4


def test_a_garment_takes_the_colour_behind_it_and_keeps_its_texture():
    rng = np.random.default_rng(0)
    parts = np.full(SHAPE, 100, np.uint8)
    parts[60:160, 60:110], parts[60:160, 150:200] = 1, 5  # hips, a bare hand
    image = np.full((*SHAPE, 3), (170, 150, 110), np.uint8)  # a tan floor
    image[parts == 1] = 40, 60, 120
    image[parts == 1] -= rng.integers(0, 20, (np.count_nonzero(parts == 1), 1), np.uint8)
    distances = []
    for _ in range(12):
        new = camouflaged(image, parts, rng)
        np.testing.assert_array_equal(new[parts != 1], image[parts != 1])
        distances.append(np.abs(new[parts == 1].mean(0) - (170, 150, 110)).max())
        if (new != image).any():
            texture = np.corrcoef(new[parts == 1][:, 2], image[parts == 1][:, 2])[0, 1]
            assert texture > 0.95
    near = np.array(distances) < 60
    assert 0 < near.sum() < len(near)  # the other garments are not in the picture
    nobody = np.full(SHAPE, 100, np.uint8)
    np.testing.assert_array_equal(camouflaged(image, nobody, rng), image)


def test_background_changes_behind_the_wearer_only():
    rng = np.random.default_rng(0)
    parts = np.full(SHAPE, 100, np.uint8)
    parts[50:150, 50:150], parts[10:30, 10:30] = 3, 200  # the wearer, another person
    image = np.full((*SHAPE, 3), 77, np.uint8)
    image[:, :20] = 0  # outside the lens
    other = rng.integers(100, 255, (*SHAPE, 3), dtype=np.uint8)
    new = replaced_background(image, parts, other, rng)
    assert (new[55:145, 55:145] == 77).all()
    assert (new[160:, 30:] > 77).mean() > 0.95
    assert (new[15:25, 22:28] > 77).all()  # other people belong to the background
    assert (new[:, :18] == 0).all()


def test_labels_under_occluders_are_hidden():
    rng = np.random.default_rng(0)
    v, u = np.mgrid[10:220:20, 10:250:20]
    grid = np.stack([u.ravel(), v.ravel()], -1).astype(float)
    hidden = 0
    for start in range(0, 108, 18):
        points = grid[start : start + 18]
        image, state = occluded(
            np.full((*SHAPE, 3), 1, np.uint8), points, np.full(18, SEEN, np.uint8), rng
        )
        cover = (image != 1).any(-1)[points[:, 1].astype(int), points[:, 0].astype(int)]
        np.testing.assert_array_equal(state == HIDDEN, cover)
        hidden += cover.sum()
    assert hidden > 3


def test_gamma_stays_in_its_range():
    image = np.full((*SHAPE, 3), 128, np.uint8)
    config = AugmentationConfig(colour=0.0)
    values = [toned(image, config, np.random.default_rng(s))[0, 0, 0] for s in range(200)]
    low, high = 255 * (128 / 255) ** 2.0, 255 * (128 / 255) ** 0.5
    assert low - 1 <= min(values) < low + 8 and high - 8 < max(values) <= high + 1


def test_no_augmentation_changes_nothing():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (*SHAPE, 3), dtype=np.uint8)
    points = rng.uniform(10, 200, (18, 2))
    given = Example(image, points, np.full(18, SEEN, np.uint8), np.full(SHAPE, 3, np.uint8))
    after = augment(given, NO_AUGMENTATION, rng, given)
    np.testing.assert_array_equal(after.image, image)
    np.testing.assert_allclose(after.points, points)
    np.testing.assert_array_equal(after.state, given.state)


def test_same_generator_same_image_and_the_source_stays():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (*SHAPE, 3), dtype=np.uint8)
    given = Example(
        image.copy(), rng.uniform(10, 200, (18, 2)), np.full(18, SEEN, np.uint8),
        rng.choice([0, 3, 15, 100], SHAPE).astype(np.uint8),
    )  # fmt: skip
    config = AugmentationConfig(1.0, 1.0, colour=1.0, blur=1.0, noise=1.0, jpeg=1.0, occluders=1.0)
    first, second = (augment(given, config, np.random.default_rng(5), given) for _ in range(2))
    np.testing.assert_array_equal(first.image, second.image)
    np.testing.assert_array_equal(given.image, image)
    assert first.image.shape == image.shape and first.image.dtype == np.uint8


def test_wearer_is_who_the_simulator_says():
    from egocap_sim.core import part_labels as parts

    mine = set(np.flatnonzero(WEARER))
    assert mine == {*range(parts.WEARER_FIRST, parts.WEARER_LAST + 1), parts.RIG}


def test_grey_images_have_equal_channels():
    image = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3), np.uint8)
    grey = greyed(image, np.random.default_rng(1))
    assert (np.ptp(grey, axis=-1) == 0).all() and grey.std() > 20


def test_exposure_clips_at_white_and_keeps_the_order():
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, 2)
    made = [exposed(ramp, np.random.default_rng(s))[0, :, 0].astype(int) for s in range(20)]
    assert all((np.diff(m) >= 0).all() for m in made)
    assert max((m == 255).sum() for m in made) > 50 and min(m.max() for m in made) < 250


def test_beyond_the_rim_it_is_black_and_labels_are_outside():
    u = np.linspace(0, SHAPE[1] - 1, 18)
    points = np.stack([u, np.full(18, (SHAPE[0] - 1) / 2)], -1)
    white, seen = np.full((*SHAPE, 3), 255, np.uint8), np.full(18, SEEN, np.uint8)
    lost = 0
    for seed in range(30):
        image, state = rimmed(white, points, seen, np.random.default_rng(seed))
        at = np.rint(points).astype(int)
        dark = image[at[:, 1], at[:, 0], 0] == 0
        assert (dark[state == OUTSIDE]).all() and (state == OUTSIDE).sum() >= dark.sum() - 1
        lost += int((state == OUTSIDE).sum())
    assert 0 < lost < 30 * 9


def test_aberration_moves_red_and_blue_apart_and_leaves_green():
    image = np.zeros((*SHAPE, 3), np.uint8)
    image[100:104, 230:234] = 255
    shifted = aberrated(image, np.random.default_rng(2))
    red, green, blue = centres(shifted)
    assert np.array_equal(shifted[..., 1], image[..., 1])
    assert abs((red - green) + (blue - green)).max() < 0.1 < abs(red - blue)[0]


def test_flare_only_adds_light():
    image = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3), np.uint8)
    lit = flared(image, np.random.default_rng(3))
    assert (lit.astype(int) >= image).all() and lit.mean() > image.mean() + 1
