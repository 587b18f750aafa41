"""The tracker's error over the bound, on a short sequence."""

import numpy as np
import pytest

from egocap.data.sequence import open_sequence
from egocap_eval.posterior.sampling import over_bound


def test_the_bound_follows_the_noise(tiny_sequence):
    sequence = open_sequence(tiny_sequence)
    fine, coarse = (over_bound(sequence, f"simulated:{sigma}", 2) for sigma in (1, 3))
    assert fine["bound_mm"] < coarse["bound_mm"] < 3.01 * fine["bound_mm"]
    assert set(fine["joints"]) == set(coarse["joints"])
    assert fine["ratio"] == pytest.approx(fine["tracked_mm"] / fine["bound_mm"], rel=0.01)


def test_the_bound_takes_a_detectors_own_spreads(tiny_sequence, monkeypatch):
    """What claims twice the spread is given the wider bound, and told to be half as far off."""
    from egocap_eval.posterior import sampling

    sequence = open_sequence(tiny_sequence)
    told = over_bound(sequence, "learned", 1)
    assert np.isfinite(told["ratio"]) and told["claimed"] > 0
    real = sampling.detections_from

    def doubtful(*args):
        found = real(*args)
        found.sigma[:] *= 2
        return found

    monkeypatch.setattr(sampling, "detections_from", doubtful)
    wide = over_bound(sequence, "learned", 1)
    assert wide["bound_mm"] > 1.2 * told["bound_mm"]
    assert wide["claimed"] == pytest.approx(told["claimed"] / 2, abs=1e-3)
