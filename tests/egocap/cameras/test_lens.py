"""Lenses: r(theta) and its inverse, against closed forms."""

import re
import warnings

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from egocap.cameras.lens import MODELS, Radial, _first_root, invert, ocam
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


def test_equidistant_lens_sees_the_image_but_no_more_than_everything() -> None:
    for radius, limit in ((1.5, 1.5), (3.0, 3.0), (4.0, np.pi)):
        lens = MODELS["equidistant"]((), None, radius)
        assert lens.limit == limit and lens.radius(np.float64(0.7))[0] == 0.7
    assert MODELS["equidistant"]((), 1.2, 3.0).limit == 1.2


@pytest.mark.parametrize("count", [4, 5, 6, 7, 8])
def test_kannala_brandt_is_its_series(count) -> None:
    k = (0.03, 0.02, -0.004, 0.001, 0.0003, -1e-4, 2e-5, 1e-6)[:count]
    lens = MODELS["kannala_brandt"](k, 1.0, 1.0)
    theta = np.linspace(0.0, 1.0, 30)
    series = theta + sum(c * theta ** (2 * i + 3) for i, c in enumerate(k))
    np.testing.assert_allclose(lens.radius(theta)[0], series, rtol=1e-13)
    for wrong in (k[:3], k + (0.0,) * (9 - count)):
        with pytest.raises(InputError) as error:
            MODELS["kannala_brandt"](wrong, 1.0, 1.0)
        assert str(error.value) == (
            f"{len(wrong)} distortion coefficients (valid: k1, k2, k3, k4, and up to k8)"
        )


@pytest.mark.parametrize("k", [(-0.2, 0.0, 0.0, 0.0), (0.1, -0.05, 0.01, -0.004),
                               (0.0, 0.0, 0.0, -0.001, 0.0, 0.0, 0.0, -1e-5)])  # fmt: skip
def test_kannala_brandt_may_reach_the_angle_where_it_turns(k) -> None:
    theta = np.linspace(0.0, np.pi, 200_001)
    turn = theta[np.argmax(theta + sum(c * theta ** (2 * i + 3) for i, c in enumerate(k)))]
    assert MODELS["kannala_brandt"](k, turn - 1e-4, 1.0).limit == turn - 1e-4
    with pytest.raises(InputError, match="not monotone"):
        MODELS["kannala_brandt"](k, turn + 1e-4, 1.0)


def test_kannala_brandt_ends_at_the_image_corner_or_before_its_turn() -> None:
    growing, turning = (0.05, 0.0, 0.0, 0.0), (-0.2, 0.0, 0.0, 0.0)
    lens = MODELS["kannala_brandt"](growing, None, 1.3)
    assert lens.radius(np.float64(lens.limit))[0] == pytest.approx(1.3, rel=1e-12)
    for radius in (9.0, 90.0):
        lens = MODELS["kannala_brandt"](growing, None, radius)
        assert lens.limit == pytest.approx(0.98 * np.pi)
    assert MODELS["kannala_brandt"](growing, np.pi, 1.3).limit == np.pi
    turn = np.sqrt(1 / 0.6)
    edge = turn - 0.2 * turn**3  # radius at which it turns
    assert MODELS["kannala_brandt"](turning, None, 1.9 * edge).limit == pytest.approx(0.98 * turn)
    with pytest.raises(
        InputError, match=r"axis only, and the image extends further \(valid: a field"
    ):
        MODELS["kannala_brandt"](turning, None, 2.1 * edge)


def test_refusal_states_the_angle_up_to_which_the_lens_grows() -> None:
    with pytest.raises(InputError) as error:
        MODELS["kannala_brandt"]((-0.2, 0.0, 0.0, 0.0), 1.5, 1.0)
    turn = np.rad2deg(np.sqrt(1 / 0.6))
    assert str(error.value) == (
        f"the lens polynomial is not monotone: it increases up to {turn:.2f} degrees off axis only,"
        f" and the field of view reaches 85.94 (valid: a field of view under {2 * turn:.2f} degrees"
        ", or another polynomial)"
    )
    with pytest.raises(InputError, match=r"up to 86\.42 degrees.*reaches 91\.67"):
        ocam((-500.0,), 1.6, 500.0)  # a pinhole: atan2(16 * 500, 500)
    with pytest.raises(InputError, match="not monotone"):
        ocam((-500.0,), np.arctan2(8000.0, 500.0), 500.0)
    with pytest.raises(InputError) as error:
        ocam((1.0,), 1.0, 500.0)
    assert str(error.value) == (
        "the polynomial's first coefficient is not negative "
        "(valid: minus the focal length, at most -0.001 pixels)"
    )
    with pytest.raises(InputError) as error:
        MODELS["equidistant"]((0.1,), 1.0, 1.0)
    assert str(error.value) == "an equidistant lens has no parameters"


def test_ocam_may_reach_the_angle_where_it_turns() -> None:
    """f(rho) = -300 - 1e-3 rho^2 bends back: theta is largest at rho = sqrt(300 / 1e-3)."""
    a = (-300.0, 0.0, -1e-3)
    rho = np.sqrt(300.0 / 1e-3)
    widest = np.arctan2(rho, 300.0 + 1e-3 * rho**2)
    assert ocam(a, 0.95 * widest, 500.0).limit == 0.95 * widest
    with pytest.raises(InputError, match="not monotone"):
        ocam(a, widest + 1e-6, 500.0)
    with pytest.raises(InputError, match="the image extends further"):
        ocam(a, None, 2.1 * rho)


def test_ocam_that_cannot_be_interpolated_is_refused() -> None:
    """Near its turn a lens runs straight up. Without a field of view, 0.98 of that angle is asked
    of a lens that turns inside the image."""
    a, rho = (-300.0, 0.0, -1e-3), np.sqrt(300.0 / 1e-3)
    widest = np.rad2deg(np.arctan2(rho, 600.0))
    for angle, radius, asked in ((np.deg2rad(widest) - 1e-9, 500.0, widest),
                                 (None, 1.9 * rho, 0.98 * widest)):  # fmt: skip
        with pytest.raises(InputError) as error:
            ocam(a, angle, radius)
        assert re.fullmatch(
            rf"the polynomial cannot be inverted to 1e-05 px up to {asked:.1f} degrees off axis "
            r"\(best \S+ px\) \(valid: a smooth lens, or a smaller field of view\)",
            str(error.value),
        )


def test_shortest_ocam_lens_is_accepted() -> None:
    assert ocam((-0.001, 0.0, 0.0), 0.5, 0.01).radius(np.float64(0.5))[0] == pytest.approx(
        0.001 * np.tan(0.5), rel=1e-3
    )


@pytest.mark.parametrize("more", [(0.0, 1e306), (*[0.0] * 90, 1e-300)], ids=["large", "long"])
def test_polynomials_that_overflow_are_refused_without_a_warning(more) -> None:
    with warnings.catch_warnings(), pytest.raises(InputError) as error:
        warnings.simplefilter("error")
        ocam((-300.0, *more), 1.0, 500.0)
    assert str(error.value) == "the lens polynomial overflows inside the image"


def test_ocam_divides_by_nothing() -> None:
    with np.errstate(divide="raise", invalid="raise"):
        assert ocam(OCAM, 1.8, 600.0).limit == 1.8


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(-1.5, 1.5), min_size=1, max_size=4), st.floats(0.2, 3.0))
def test_first_root_is_the_smallest_in_the_interval(roots, high) -> None:
    """Of (x - r1) (x - r2) ... times a polynomial without real roots."""
    apart = np.abs(np.subtract.outer(roots, roots))[~np.eye(len(roots), dtype=bool)]
    assume((apart > 0.05).all() and (np.abs(roots) > 0.05).all())
    assume((np.abs(np.array(roots) - high) > 0.05).all())
    coefficients = np.polynomial.polynomial.polyfromroots(roots)
    coefficients = np.polynomial.polynomial.polymul(coefficients, [1.0, 0.5, 1.0])
    inside = [r for r in roots if 0 < r < high]
    found = _first_root([*map(float, coefficients), 1e-30], high)
    assert found == pytest.approx(min(inside, default=np.inf), rel=1e-5)


def test_constants_have_no_root() -> None:
    assert _first_root([2.0], 1.0) == _first_root([0.0], 1.0) == np.inf
    assert _first_root([0.0, 0.0, 0.0], 1.0) == np.inf
    assert _first_root([-1.0, 1.0], 1.0) == pytest.approx(1.0)  # the end counts


@pytest.mark.parametrize("scale", [1e-200, 1e-10, 1.0, 1e200])
def test_first_root_is_above_zero_real_and_of_any_scale(scale) -> None:
    beside = np.polynomial.polynomial.polyfromroots([0.5, 1e-6 + 5e-7j, 1e-6 - 5e-7j]).real
    for coefficients in ([0.0, -1.0, 2.0], [-1.0, 2.0], [-1.0, 2.0, 1e-18], beside):
        found = _first_root([float(scale * c) for c in coefficients], 1.0)
        assert found == pytest.approx(0.5)


@pytest.mark.parametrize("kind", ["numpy", "torch", "torch32"])
def test_inversion_converges_fast_from_a_good_start_and_surely_from_a_bad_one(kind) -> None:
    """Newton's method on a sigmoid overshoots from its flat ends; bisection brings it back."""
    array = {
        "numpy": np.asarray,
        "torch": torch.tensor,
        "torch32": lambda x: torch.tensor(x, dtype=torch.float32),
    }[kind]
    calls = 0

    def sigmoid(x):
        nonlocal calls
        calls += 1
        value = (np if kind == "numpy" else torch).tanh(8.0 * (x - 1.0))
        return value, 8.0 * (1.0 - value * value)

    truth = np.array([0.0, 0.5, 0.9, 1.0, 1.3, 2.0])
    target = array(np.tanh(8.0 * (truth - 1.0)))
    for start, most in ((truth + 1e-3, 7), (2.0 - truth, 22)):
        calls = 0
        found = np.asarray(invert(sigmoid, target, 2.0, array(start)))
        flat = 1e-2 if kind == "torch32" else 1e-8  # at the ends, where slopes are 1e-6
        np.testing.assert_allclose(found, truth, atol=flat)
        np.testing.assert_allclose(found[2:4], truth[2:4], atol=1e-6 if flat > 1e-3 else 1e-14)
        assert calls <= most


def test_inversion_knows_no_direction_at_a_flat_start() -> None:
    """x^3 from 0, where it is flat, and for the target 0; the target may exceed the bracket."""
    target = np.array([0.0, 0.3, 1.0, 27.0])
    with np.errstate(divide="raise", invalid="raise"):
        found = invert(lambda x: (x**3, 3 * x**2), target, 4.0, np.zeros(4))
    np.testing.assert_allclose(found, np.cbrt(target), atol=1e-9)


def test_inversion_keeps_to_its_bracket() -> None:
    """A steep sigmoid of other units than its argument, from its flat ends."""
    most = 0.0

    def sigmoid(x):
        nonlocal most
        most = max(most, abs(x).max())
        value = 50.0 + 50.0 * np.tanh(8.0 * (x - 1.0))
        return value, 400.0 / np.cosh(8.0 * (x - 1.0)) ** 2

    truth = np.array([0.6, 0.9, 1.0, 1.3, 1.4])
    target = 50.0 + 50.0 * np.tanh(8.0 * (truth - 1.0))
    np.testing.assert_allclose(invert(sigmoid, target, 2.0, 2.0 - truth), truth, atol=1e-9)
    assert most <= 2.0


class Counted(Radial):
    """A lens that counts the evaluations of its radius."""

    calls = 0

    def radius(self, theta):
        Counted.calls += 1
        return super().radius(theta)


def test_angles_are_found_in_a_few_steps() -> None:
    """The lens is nearly equidistant: the search starts at the angle in proportion."""
    lens = MODELS["ocam"](*LENSES["ocam"])
    counted = Counted(lens.coefficients, lens.limit, lens.middle, lens.half)
    radii = np.linspace(0.0, float(lens.radius(np.float64(lens.limit))[0]), 50)
    Counted.calls = 0
    np.testing.assert_allclose(counted.radius(counted.angle(radii))[0], radii, atol=1e-9)
    assert Counted.calls <= 10


def test_search_for_angles_is_not_in_the_autograd_graph(lens) -> None:
    """Only the last Newton step is: two subtractions, a division and their input."""
    radii = torch.linspace(0.1, 0.9, 5, dtype=torch.float64, requires_grad=True)
    assert graph_size(lens.angle(radii)) == 4


def graph_size(tensor):
    """Number of operations in the graph of a tensor."""
    found, todo = set(), [tensor.grad_fn]
    while todo:
        node = todo.pop()
        if node is not None and node not in found:
            found.add(node)
            todo += [parent for parent, _ in node.next_functions]
    return len(found)
