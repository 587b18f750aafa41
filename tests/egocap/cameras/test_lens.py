"""Lenses: r(theta) and its inverse, against closed forms."""

import numpy as np
import pytest

from egocap.cameras.lens import MODELS, Radial, ocam
from egocap.errors import InputError

OCAM = (-283.0247, 0.0, 1.130153e-3, -1.870746e-7, 1.54814e-9)
LENSES = {
    "equidistant": ((), 1.9, 1.0),
    "kannala_brandt": ((0.05, -0.01, 0.004, -0.0005), 1.8, 1.0),
    "ocam": (OCAM, 1.8, 600.0),
}


@pytest.fixture(params=LENSES)
def lens(request) -> Radial:
    """Each lens in turn."""
    return MODELS[request.param](*LENSES[request.param])


def test_radius_grows_at_its_slope_and_goes_straight_on_outside(lens: Radial) -> None:
    theta = np.linspace(0.0, np.pi, 800)
    r, slope = lens.radius(theta)
    h = 1e-6
    numeric = (lens.radius(theta + h)[0] - lens.radius(theta - h)[0]) / (2 * h)
    assert r[0] == 0.0 and (np.diff(r) > 0).all()
    np.testing.assert_allclose(slope, numeric, rtol=1e-6)
    assert np.ptp(slope[theta > lens.limit]) < 1e-9


def test_angle_inverts_radius_at_every_angle(lens: Radial) -> None:
    theta = np.concatenate([[0.0, 1e-12, 1e-6, lens.limit], np.linspace(0.0, np.pi, 500)])
    np.testing.assert_allclose(lens.angle(lens.radius(theta)[0]), theta, atol=1e-13)


def test_ocam_is_the_inverse_of_its_polynomial() -> None:
    lens = ocam(OCAM, None, 436.0)
    rho = np.linspace(0.0, 436.0, 3000)
    theta = np.arctan2(rho, -np.polynomial.polynomial.polyval(rho, OCAM))
    assert abs(lens.radius(theta)[0] - rho).max() < 1e-4
    assert lens.limit == pytest.approx(theta[-1], abs=1e-12)


def test_ocam_with_one_coefficient_is_a_pinhole() -> None:
    lens = ocam((-500.0,), 1.2, 500.0)
    theta = np.linspace(0.0, 1.2, 50)
    np.testing.assert_allclose(lens.radius(theta)[0], 500.0 * np.tan(theta), atol=1e-4)


@pytest.mark.parametrize(
    ("model", "parameters", "max_angle", "message"),
    [
        ("ocam", (300.0, 0.0, 1e-3), 1.0, "not negative"),
        ("ocam", (), 1.0, "not negative"),
        ("ocam", (-300.0, 0.0, -1e-3), 1.5, "not monotone"),
        ("ocam", (-500.0,), 1.6, "not monotone"),
        ("kannala_brandt", (-0.2, 0.0, 0.0, 0.0), 1.5, "not monotone"),
        ("kannala_brandt", (0.1, 0.0), 1.5, "k1, k2, k3, k4"),
        ("kannala_brandt", (-0.2, 0.0, 0.0, 0.0), None, "not monotone.*image extends further"),
        ("ocam", (-100.0, 0.0, -1e-2), None, "not monotone.*image extends further"),
        ("ocam", (-1e-200, 0.0, 1.0), 1.0, "not negative"),
        ("equidistant", (1.0,), 1.5, "no parameters"),
    ],
)
def test_impossible_lenses_are_refused(model, parameters, max_angle, message) -> None:
    with pytest.raises(InputError, match=message):
        MODELS[model](parameters, max_angle, 500.0)


def test_without_a_field_of_view_the_lens_ends_before_it_turns() -> None:
    turn = np.sqrt(1 / 0.6)  # 1 - 3 * 0.2 theta^2 = 0
    lens = MODELS["kannala_brandt"]((-0.2, 0.0, 0.0, 0.0), None, 1.5)
    assert 0.9 * turn < lens.limit < turn
    assert float(lens.radius(np.float64(lens.limit))[1]) > 0
