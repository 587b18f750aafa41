"""The study of personalised tracking: whose clips, and what counts as missed."""

import numpy as np
import pytest

from egocap.errors import InputError
from egocap_eval.studies.personalised import (
    BODIES,
    _means,
    _missed,
    development_cases,
    study,
    validation_cases,
)
from egocap_sim.world.world import World


def test_calibration_shows_the_same_person_in_another_motion():
    (case,) = development_cases(1, 400100, 30)
    people = [World(scene).person for scene in (case.calibration, *case.clips)]
    heights = [person.height_m for person in people]
    assert len(set(heights)) == 1
    motions = [scene.motion.name for scene in (case.calibration, *case.clips)]
    assert motions == ["sequence", "walk", "gestures"]
    assert case.calibration.frames == 360


def test_the_validation_people_are_tracked_as_their_scenes_say():
    walk, gesture = validation_cases()
    assert [c.clips[0].frames for c in (walk, gesture)] == [250, 750]
    assert walk.clips[0].motion.name == "walk"
    assert walk.calibration.seed == walk.clips[0].seed == 162
    assert gesture.calibration.seed == gesture.clips[0].seed == 163


def row(sequence, body, **errors):
    whole = {"mpjpe_mm": 10.0, "upper_mm": 10.0, "lower_mm": 10.0, "seen_mm": 10.0}
    return {"sequence": sequence, "body": body, "frames": 2} | whole | errors


def test_what_misses_its_target_is_named():
    lines = {"knee": {"error_percent": -3.4, "determined": "well"},
             "hand": {"error_percent": 9.0, "determined": "prior"}}  # fmt: skip
    rows = [row("validation-walk", "fitted", mpjpe_mm=31.0),
            row("validation-walk", "average", mpjpe_mm=99.0),
            row("validation-gesture", "fitted", upper_mm=np.nan)]  # fmt: skip
    missed = _missed({"a": lines}, rows)
    assert len(missed) == 3
    assert missed[0].startswith("a, knee: 3.4 %") and "validation-walk, mpjpe_mm: 31.0" in missed[1]
    means = _means([row("w", body, mpjpe_mm=v) for body in BODIES
                    for v in (10.0, 20.0)])  # fmt: skip
    assert means["true"]["mpjpe_mm"] == pytest.approx(15.0)


def test_training_and_validation_seeds_are_refused(tmp_path):
    for seed in (162, 300000, 409999):
        with pytest.raises(InputError, match="400000 to 409999"):
            study(tmp_path, people=6, first_seed=seed)
