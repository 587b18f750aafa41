"""The study of fitted bodies: errors by verdict."""

import pytest

from egocap_eval.studies.fit_body import summary


def line(error, std, verdict):
    return {"error_percent": error, "std_percent": std, "determined": verdict}


def test_errors_are_summed_up_by_verdict():
    one = {"elbow": line(-1.0, 1.0, "well"), "knee": line(4.0, 2.0, "well")}
    found = summary({"a": one, "b": {"hip": line(-6.0, 6.0, "prior")}})
    assert found["well"] == {
        "bones": 2, "mean_percent": 2.5, "worst_percent": 4.0, "share_within_3_percent": 0.5,
    }  # fmt: skip
    assert found["prior"]["worst_percent"] == 6.0 and "badly" not in found
    assert found["error_over_stated_std_rms"] == pytest.approx(2.0**0.5, abs=0.01)
