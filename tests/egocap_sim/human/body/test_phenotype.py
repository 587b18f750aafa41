"""Phenotypes: corner weights against manual cases, and invalid values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.errors import InputError
from egocap_sim.human.body.phenotype import Phenotype, age_from_years, blend_weights, corner_weights

share = st.floats(0.0, 1.0)


@settings(deadline=None, max_examples=50)
@given(share, share, share, share)
def test_corner_weights_of_each_quality_sum_to_one(gender, age, muscle, weight):
    table = corner_weights(Phenotype(gender=gender, age=age, muscle=muscle, weight=weight))
    for group in (
        ("male", "female"),
        ("young", "old"),
        ("minmuscle", "averagemuscle", "maxmuscle"),
        ("minweight", "averageweight", "maxweight"),
        ("african", "asian", "caucasian"),
    ):
        values = [table[name] for name in group]
        assert min(values) >= 0
        assert sum(values) == pytest.approx(1)


def test_blend_weight_is_the_product_of_its_corners():
    corners = np.array(["male", "female", "young", "old"])
    mask = np.array([[True, False, True, False], [False, True, False, True], [False] * 4])
    weights = blend_weights(Phenotype(gender=0.25, age=0.5), corners, mask)
    assert weights == pytest.approx([0.75 * 0.5, 0.25 * 0.5, 1.0])


def test_ages():
    assert age_from_years(18) == age_from_years(25) == 0.0
    assert age_from_years(90) == 1.0
    for years in (17.9, 91, float("nan")):
        with pytest.raises(InputError, match="18 to 90"):
            age_from_years(years)


@pytest.mark.parametrize("bad", [{"weight": 1.2}, {"muscle": -0.1}, {"gender": float("nan")}])
def test_values_outside_zero_to_one_raise(bad):
    with pytest.raises(InputError, match="0 to 1"):
        Phenotype(**bad)


def test_no_ancestry_raises():
    with pytest.raises(InputError, match="ancestry"):
        Phenotype(african=0, asian=0, caucasian=0)
