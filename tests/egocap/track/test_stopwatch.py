"""The tracker tells of all frames, bit by bit, whatever its stages."""

import pytest

from egocap.pose.config import TrackerConfig
from egocap.track.stopwatch import StageProgress, planned_laps
from egocap.track.tracker import Tracker


@pytest.mark.parametrize("smoothing", ["interval", "gaussian", "fixed-lag"])
def test_stages_add_up_to_all_frames(motion, smoothing):
    told = []
    Tracker(motion.rig, motion.person, TrackerConfig(smoothing=smoothing)).track(
        motion.detect("simulated:2"), on_frames=told.append
    )
    assert sum(told) == len(motion.detect("simulated:2").times)
    assert len(told) > 2 and min(told) > 0


def test_the_plan_is_what_is_lapped(motion, monkeypatch):
    laps = []
    monkeypatch.setattr(StageProgress, "lap", lambda self, stage: laps.append(stage))
    config = TrackerConfig()
    Tracker(motion.rig, motion.person, config).track(motion.detect("simulated:2"))
    planned = planned_laps(config, images=False, world=False)
    assert {s: laps.count(s) for s in laps} == {s: n for s, n in planned.items() if n}


def test_more_stages_than_planned_stay_below_all_frames():
    told = []
    progress = StageProgress(100, TrackerConfig(), told.append, images=False, world=False)
    for _ in range(100):
        progress.lap("smoothing")
    assert sum(told) == 98
    progress.finish()
    assert sum(told) == 100
