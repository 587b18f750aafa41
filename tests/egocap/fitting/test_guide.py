"""The guide asks for what is least certain, and stops when the bones are known or cannot be."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.errors import InputError
from egocap.fitting.config import FitConfig
from egocap.fitting.fit_body import SYSTEMATIC
from egocap.fitting.guide import BONES, REQUESTS, Guide, joined

FEW = FitConfig(frames=15)
LEGS = [
    i for i, name in enumerate(LABELS) if name.split("_")[-1] in ("hip", "knee", "ankle", "foot")
]


def show(guide, found, seconds=1.0):
    """The guide's requests, of a wearer who shows the same motion each time, a second later."""
    asked, later = [], 0.0
    while guide.request is not None:
        asked.append(guide.request)
        for t, time in enumerate(found.times + later):
            if guide.due(time):
                guide.add(replace(found[t : t + 1], times=np.array([time])))
        later += float(np.ptp(found.times)) + seconds
        guide.advance()
    return asked


@pytest.fixture(scope="module")
def found(motion):
    return motion.detect("simulated:1.0")


def test_it_stops_when_arms_and_legs_are_known(motion, found):
    guide = Guide(motion.rig, config=FEW)
    assert guide.request is REQUESTS[0]
    asked = show(guide, found)
    assert 2 <= len(asked) < len(REQUESTS)
    assert {end for request in asked for end in request.shows} >= set(BONES)
    assert max(guide.uncertainty().values()) <= np.hypot(0.02, SYSTEMATIC)  # 2 % by noise
    assert guide.finished is guide.fit


def test_it_asks_for_legs_that_were_not_seen_and_gives_up(motion, found):
    blind = found.valid.copy()
    blind[..., LEGS] = False
    guide = Guide(motion.rig, config=FEW)
    asked = show(guide, replace(found, valid=blind))
    legs = [r for r in REQUESTS if {"knee", "ankle"} & set(r.shows)]
    assert {r for r in asked[1:] if asked.count(r) == 2} == set(legs)
    known = guide.uncertainty()
    assert known["wrist"] <= 0.03
    assert known["ankle"] == 1.0


def test_instants_that_follow_fast_are_thinned(motion, found):
    guide = Guide(motion.rig)
    guide.add(found[:1])
    start = found.times[0]
    assert not guide.due(start + 0.04)
    assert guide.due(start + 0.1)
    assert np.array_equal(joined([found[:3], found[3:5]]).points, found[:5].points)


def test_nothing_detected_is_an_error_in_the_end(motion, found):
    guide = Guide(motion.rig)
    show(guide, replace(found, valid=np.zeros_like(found.valid)))
    with pytest.raises(InputError, match="no body part"):
        _ = guide.finished


def test_an_impossible_height_is_refused_before_anything_is_asked(motion):
    with pytest.raises(InputError, match="178"):
        Guide(motion.rig, height=178.0)
