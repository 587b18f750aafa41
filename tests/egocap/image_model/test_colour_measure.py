"""The colour dissimilarity against the paper's words, other libraries and numbers by hand."""

import colorsys

import numpy as np
import pytest
import torch

from egocap.errors import InputError
from egocap.image_model.colour_measure import (
    PAPER,
    ColourMeasure,
    blend_weights,
    cone,
    dissimilarity,
    hsv_to_rgb,
    hue_distance,
    rgb_to_hsv,
    smooth_step,
)

RNG = np.random.default_rng(0)


def test_hsv_is_that_of_colorsys():
    rgb = np.concatenate([RNG.uniform(size=(200, 3)), [[0, 0, 0], [1, 1, 1], [0.5, 0.5, 0.5]]])
    expected = [colorsys.rgb_to_hsv(*row) for row in rgb]
    np.testing.assert_allclose(rgb_to_hsv(rgb), expected, atol=1e-12)
    np.testing.assert_allclose(hsv_to_rgb(expected), rgb, atol=1e-12)
    np.testing.assert_allclose(rgb_to_hsv(np.array([255, 0, 0], np.uint8)), [0, 1, 1])


def test_smooth_step_runs_from_alike_to_unlike_and_stays():
    x = np.linspace(0, 1, 1001)
    y = smooth_step(x)
    assert y[0] == -1.0 and y[-1] == 1.0 and (np.diff(y) >= 0).all()
    assert abs(np.gradient(y, x)[[0, -1]]).max() < 0.05
    assert smooth_step(np.array(2.0)) == 1.0  # the bare polynomial falls to -17 there


def test_hues_wrap_around():
    assert hue_distance(np.array(0.95), np.array(0.05)) == pytest.approx(0.2)
    assert hue_distance(np.array(0.0), np.array(0.5)) == 1.0


def test_weights_sum_to_one_for_every_colour():
    colours = np.concatenate([RNG.uniform(size=(500, 3)), [[0, 0, 0], [0, 0, 1], [0, 1, 0]]])
    total = sum(blend_weights(colours))
    np.testing.assert_allclose(total, 1.0)


def test_weights_are_the_papers_formulas():
    """w_s = sqrt(s), w_d = max(0, 0.5 - v), w_g = max(0, 0.5 - s), over their sum (appendix A)."""
    dark_green, pale = np.array([0.3, 0.64, 0.1]), np.array([0.3, 0.09, 0.3])
    np.testing.assert_allclose(blend_weights(dark_green), np.array([0.8, 0.4, 0.0]) / 1.2)
    np.testing.assert_allclose(blend_weights(pale), np.array([0.3, 0.2, 0.41]) / 0.91)
    at_half = np.array([0.3, 0.49, 0.45])  # just below 0.5, where both still count
    np.testing.assert_allclose(blend_weights(at_half), np.array([0.7, 0.05, 0.01]) / 0.76)


def test_dissimilarity_blends_the_papers_three_terms():
    model, image = np.array([0.2, 0.25, 0.3]), np.array([0.9, 0.35, 0.6])
    d_s, d_d, d_g = 0.6**2, 2 * 0.3**2, 0.3 + 0.1
    x = (0.5 * d_s + 0.2 * d_d + 0.25 * d_g) / 0.95
    expected = 1 - (1 - x) ** 4 * (8 * x + 2)
    assert dissimilarity(model, image) == pytest.approx(expected)


def test_smooth_step_by_hand():
    assert smooth_step(np.array(0.5)) == pytest.approx(1 - 0.5**4 * 6)
    assert smooth_step(np.array(-1.0)) == -1.0


def test_saturated_colours_ignore_light_and_grey_ones_hue():
    red, dim_red, cyan = np.array([0.0, 1, 1]), np.array([0.0, 1, 0.55]), np.array([0.5, 1, 1])
    assert dissimilarity(red, dim_red) == -1.0
    assert dissimilarity(red, cyan) == 1.0
    grey, bluish = np.array([0.0, 0, 0.7]), np.array([0.6, 0, 0.7])
    assert dissimilarity(grey, bluish) == -1.0
    black, lit = np.array([0.0, 0, 0]), np.array([0.0, 0, 1.0])
    assert dissimilarity(black, lit) == 1.0  # its sum is 1.5: held at 1


@pytest.mark.parametrize("measure", [PAPER, ColourMeasure("paper", 0.25), ColourMeasure()])
def test_a_colour_is_most_like_itself(measure):
    colours = RNG.uniform(size=(50, 3))
    every = measure.compare(colours[:, None], measure.features(colours)[None])
    assert np.diag(every) == pytest.approx(-1.0)
    assert every.max() <= 1.0
    torch_form = measure.compare(
        torch.tensor(colours)[:, None], measure.features(torch.tensor(colours))[None]
    )
    np.testing.assert_allclose(torch_form.numpy(), every, atol=1e-12)


def test_cone_tells_a_grey_floor_from_a_vivid_shirt_where_hue_does_not():
    shirt, floor = np.array([0.5, 0.9, 0.5]), np.array([0.5, 0.08, 0.4])
    assert PAPER.compare(shirt, PAPER.features(floor)) == -1.0
    by_cone = ColourMeasure("cone", 0.2)
    assert by_cone.compare(shirt, by_cone.features(floor)) == 1.0


def test_wrong_settings_are_refused():
    with pytest.raises(InputError, match="colour measure"):
        ColourMeasure("rgb")
    with pytest.raises(InputError, match="reach"):
        ColourMeasure("cone", 0.0)


def test_refusals_say_what_is_valid():
    with pytest.raises(InputError) as error:
        ColourMeasure("rgb")
    assert str(error.value) == "no colour measure 'rgb' (valid: paper, cone)"
    for reach in (0.0, 2.1, np.nan):
        with pytest.raises(InputError) as error:
            ColourMeasure("cone", reach)
        assert str(error.value) == f"a colour reach of {reach} (valid: above 0, to 2)"
    assert ColourMeasure("cone", 2.0).reach == 2.0
    assert ColourMeasure("paper", 1e-3).reach == 1e-3


def test_cone_has_its_axis_in_the_greys_and_its_rim_in_the_full_colours():
    """Chroma times the hue's direction, and half the brightness."""
    hsv = np.array([[0.3, 0.0, 0.8], [0.0, 1.0, 1.0], [0.25, 0.5, 0.8], [2 / 3, 1.0, 0.5],
                    [0.9, 0.7, 0.0]])  # fmt: skip
    expected = [[0, 0, 0.4], [1, 0, 0.5], [0, 0.4, 0.4],
                [-0.25, -np.sqrt(3) / 4, 0.25], [0, 0, 0]]  # fmt: skip
    np.testing.assert_allclose(cone(hsv), expected, atol=1e-15)
    np.testing.assert_allclose(cone(torch.tensor(hsv)).numpy(), expected, atol=1e-15)


@pytest.mark.parametrize("reach", [0.4, 0.6])
def test_cone_measure_is_the_smooth_step_of_the_squared_distance_in_reaches(reach):
    measure = ColourMeasure("cone", reach)
    model, image = np.array([0.0, 0.5, 0.6]), np.array([0.5, 0.1, 0.7])
    squared = (0.3 + 0.07) ** 2 + (0.5 * 0.1) ** 2  # opposite hues
    expected = smooth_step(np.array(squared / reach**2))
    assert measure.compare(model, measure.features(image)) == pytest.approx(expected)
    assert ColourMeasure().compare(model, cone(image)) == pytest.approx(
        smooth_step(np.array(squared / 0.2**2))
    )


def test_paper_measure_reaches_the_hue_distance_it_is_given():
    """Of saturated colours: hues a quarter turn apart are half alike at 1, and unlike at 0.5."""
    model, image = np.array([0.0, 1.0, 1.0]), np.array([0.25, 1.0, 1.0])
    whole, half = ColourMeasure("paper", 1.0), ColourMeasure("paper", 0.5)
    assert whole.compare(model, whole.features(image)) == smooth_step(np.array(0.25))
    assert half.compare(model, half.features(image)) == 1.0
    assert dissimilarity(model, image) == dissimilarity(model, image, 1.0)


@pytest.mark.parametrize("kind", [np.uint8, np.float32, float])
def test_hsv_of_every_kind_of_numbers(kind):
    """Eight bits are of 255, floats of 1; each is computed in float64."""
    rgb = np.array([[255, 51, 0], [0, 102, 204], [255, 0, 51], [0, 0, 0], [0, 0, 1], [51, 255, 51]])
    given = rgb.astype(np.uint8) if kind is np.uint8 else (rgb / 255).astype(kind)
    expected = [colorsys.rgb_to_hsv(*row) for row in np.asarray(rgb / 255, np.float64)]
    found = rgb_to_hsv(given)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, expected, atol=1e-12 if kind is not np.float32 else 1e-6)
    assert rgb_to_hsv([1.0, 0.0, 0.0]).tolist() == [0.0, 1.0, 1.0]
    assert hsv_to_rgb([0.0, 1.0, 1.0]).tolist() == [1.0, 0.0, 0.0]
    single = found.astype(np.float32)
    np.testing.assert_array_equal(hsv_to_rgb(single), hsv_to_rgb(single.astype(np.float64)))
    np.testing.assert_allclose(hsv_to_rgb(single), rgb / 255, atol=1e-6)


def test_images_keep_their_shape():
    image = RNG.uniform(size=(4, 5, 3))
    hsv = rgb_to_hsv(image)
    np.testing.assert_allclose(hsv[2, 3], colorsys.rgb_to_hsv(*image[2, 3]))
    np.testing.assert_allclose(hsv_to_rgb(hsv), image)
    assert cone(hsv).shape == image.shape


def test_faint_colours_keep_their_hue():
    """However little red exceeds blue, and however dark it is."""
    for value in (1e-9, 1e-300):
        np.testing.assert_allclose(
            rgb_to_hsv(value * np.array([1.0, 0.5, 0.25])), [1 / 18, 0.75, value]
        )


def test_greys_and_black_are_no_division_by_zero():
    with np.errstate(divide="raise", invalid="raise"):
        found = rgb_to_hsv(np.array([[0.0, 0, 0], [0.4, 0.4, 0.4]]))
    np.testing.assert_array_equal(found, [[0, 0, 0], [0, 0, 0.4]])


def test_hue_a_rounding_error_below_red_is_red():
    assert rgb_to_hsv(np.array([1.0, 0.0, 1e-17]))[0] == 0.0
    assert 0.999 < rgb_to_hsv(np.array([1.0, 0.0, 1e-3]))[0] < 1.0


@pytest.mark.parametrize("measure", [PAPER, ColourMeasure("cone", 0.9)], ids=["paper", "cone"])
def test_measure_is_differentiable_by_both_colours(measure):
    """Autograd against finite differences, away from the kinks of the paper's blend."""
    model = torch.tensor([[0.2, 0.3, 0.4], [0.9, 0.7, 0.6]], dtype=torch.float64)
    image = torch.tensor([[0.3, 0.4, 0.3], [0.1, 0.6, 0.7]], dtype=torch.float64)

    def compare(m, i):
        return measure.compare(m, measure.features(i))

    assert torch.autograd.gradcheck(compare, (model.requires_grad_(), image.requires_grad_()))
