"""Tracks of rendered motions: acted out by two people, detected, tracked, and kept."""

from dataclasses import replace

import numpy as np

from egocap_eval.priors import rendered
from egocap_eval.priors.rendered import RECORDINGS, rendered_tracks


def test_motions_are_rendered_detected_and_tracked_on_two_rigs(monkeypatch, tmp_path):
    short = [replace(of, rigs=of.rigs[:1], frames=6) for of in RECORDINGS]
    monkeypatch.setattr(rendered, "RECORDINGS", short)
    first = rendered_tracks(None, ("gestures",), tmp_path, 1)
    again = rendered_tracks(None, ("gestures",), tmp_path, 1)  # from the kept ones
    assert [t.name for t in first] == ["builtin-gestures-0"] * 2
    for track, kept in zip(first, again, strict=True):
        assert track.angles.shape == (6, 37) and track.std.shape == (6, 18)
        assert 1.0 < track.error_mm < 150.0
        assert np.array_equal(track.angles, kept.angles)
    assert not np.allclose(first[0].offsets, first[1].offsets)  # another person
