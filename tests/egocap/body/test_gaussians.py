"""The volumetric body: its count, symmetry, outline, file."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.body.gaussians import RADIUS_SIGMAS, SKULL, GaussianBody, stature
from egocap.body.proportions import Proportions
from egocap.errors import EgocapError, FileError, InputError
from tests.egocap.conftest import rewritten

PERSON = Proportions.from_lengths(1.75)


def outline_depth(body, part, sideways):
    """Optical depth of a ray across the middle of a limb, `sideways` metres off its axis."""
    mine = [i for i, name in enumerate(body.parts) if name == part]
    x, z = body.offset[mine, 0], body.offset[mine, 2]
    height = (z.min() + z.max()) / 2
    squared = (x - sideways) ** 2 + (z - height) ** 2
    s = body.sigma[mine]
    return np.sum(body.density[mine] * s * np.sqrt(2 * np.pi) * np.exp(-0.5 * squared / s**2))


def test_there_are_91_and_left_mirrors_right():
    body = GaussianBody.from_proportions(PERSON)
    assert len(body.parts) == 91
    left = [i for i, p in enumerate(body.parts) if p.startswith("left_")]
    right = [body.parts.index("right_" + body.parts[i].removeprefix("left_")) for i in left]
    assert len(left) == sum(p.startswith("right_") for p in body.parts)
    np.testing.assert_allclose(body.offset[left[0]] * [1, -1, 1], body.offset[right[0]])
    assert {SKULL} == set(body.joint[[p == "head" for p in body.parts]])


@pytest.mark.parametrize("part", ["left_forearm", "right_upper_arm", "left_thigh", "left_shank"])
def test_half_the_light_passes_near_the_radius_and_little_through_the_axis(part):
    body = GaussianBody.from_proportions(PERSON)
    radius = RADIUS_SIGMAS * body.sigma[[p == part for p in body.parts]].mean()
    assert np.exp(-outline_depth(body, part, radius)) == pytest.approx(0.5, abs=0.12)
    assert np.exp(-outline_depth(body, part, 0.0)) < 0.06
    assert np.exp(-outline_depth(body, part, 2.0 * radius)) > 0.98


def test_scales_with_the_person_and_the_girth():
    small = GaussianBody.from_proportions(Proportions.from_lengths(1.5))
    tall = GaussianBody.from_proportions(Proportions.from_lengths(1.8))
    wide = GaussianBody.from_proportions(Proportions.from_lengths(1.5), girth=1.3)
    np.testing.assert_allclose(tall.sigma / small.sigma, 1.2)
    assert stature(tall.proportions) == pytest.approx(1.8)
    np.testing.assert_allclose(wide.sigma / small.sigma, 1.3 / 0.98)
    with pytest.raises(InputError, match="girth"):
        GaussianBody.from_proportions(PERSON, girth=5.0)


def test_file_gives_every_number_back(tmp_path):
    colour = np.random.default_rng(0).uniform(size=(91, 3))
    body = GaussianBody.from_proportions(PERSON).with_colour(colour)
    body.save(tmp_path / "g.json")
    again = GaussianBody.load(tmp_path / "g.json")
    for name in ("joint", "offset", "sigma", "density", "colour"):
        np.testing.assert_array_equal(getattr(again, name), getattr(body, name))
    assert again.parts == body.parts
    np.testing.assert_array_equal(again.proportions.offsets, PERSON.offsets)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(schema_version=99), "newer version"),
        (lambda d: d["gaussians"][3].update(joint="tail"), "gaussians.3.joint"),
        (lambda d: d["gaussians"][3].update(sigma=-1.0), "sigma"),
        (lambda d: d["gaussians"][3].update(hsv=[0.0, 2.0, 0.0]), "colour"),
        (lambda d: d["gaussians"][0].pop("offset"), "offset"),
        (lambda d: d["body"].pop("neck"), "neck"),
        (lambda d: d.update(gaussians=[]), "gaussians"),
    ],
)
def test_a_bad_file_is_refused_with_its_key(tmp_path, change, message):
    path = tmp_path / "g.json"
    GaussianBody.from_proportions(PERSON).save(path)
    with pytest.raises(FileError, match=message):
        GaussianBody.load(rewritten(path, change))


@settings(deadline=None, max_examples=30)
@given(st.binary(max_size=200))
def test_no_file_breaks_the_reader(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("g") / "g.json"
    path.write_bytes(data)
    with pytest.raises(EgocapError):
        GaussianBody.load(path)
