"""The planted gap: one person and motion in a plain world and in one of faults and photographs."""

from egocap_eval.studies.adaptation import ADAPTED, MEASURED, _closed, _missed, scenes


def test_worlds_differ_in_sensor_and_surfaces_alone(tmp_path):
    footage, harsh, clean = scenes(400_950, 40.0, 12.0, tmp_path)
    assert footage.place == harsh.place and footage.place.textures == str(tmp_path)
    assert clean.place == harsh.place.model_copy(update={"textures": None})
    assert footage.sensor == harsh.sensor and harsh.sensor.preset == "harsh"
    assert not harsh.sensor.miscalibrated
    assert (footage.frames, harsh.frames, clean.frames) == (600, 180, 180)
    assert tuple(footage.motion.parameters["parts"]) == ADAPTED
    assert harsh.motion == clean.motion and tuple(harsh.motion.parameters["parts"]) == MEASURED
    assert footage.seed == harsh.seed == clean.seed


def test_share_of_the_gap_and_harm_are_judged():
    mean = {case: {"pck20_in_view": value} for case, value in
            (("clean", 90.0), ("harsh", 70.0), ("harsh, adapted", 78.0))}  # fmt: skip
    assert _closed(mean, "pck20_in_view") == 0.4
    row = {"person": 1, **mean, "clean, adapted": {"pck20_in_view": 89.0}}
    missed = _missed({"rows": [row], "gap_closed": {"pck20_in_view": 0.4}})
    assert missed == ["40 % of the gap closed, 50 asked", "person 1, clean: 1.0 points lost"]
