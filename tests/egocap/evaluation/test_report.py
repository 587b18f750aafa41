import json
from dataclasses import replace

import numpy as np
import pytest

from egocap.evaluation import GroundTruth, Report, evaluate_detections, evaluate_pose


@pytest.fixture(scope="module")
def report() -> Report:
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(200, 18, 3))
    image = rng.uniform(0, 1000, (200, 2, 18, 2))
    found = np.ones(image.shape[:3], bool)
    score = evaluate_detections(image + 2, found, image, found, found, [1280, 1280], "a|b")
    predicted = truth + 0.01 * rng.normal(size=truth.shape)
    report = evaluate_pose(predicted, GroundTruth(truth, np.arange(200) / 30))
    return replace(report, detections=score, pck20=score.pck20, auc20=score.auc20)


def test_json_is_strict_and_says_the_same(report):
    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    data = json.loads(report.to_json(), parse_constant=refuse)
    assert data["mpjpe_mm"] == report.mpjpe_mm
    assert data["detections"]["pck20"] == data["pck20"] == 100
    assert data["per_joint_mm"] == dict(report.per_joint_mm)
    assert data["units"]["accel_error"] == "m/s^2"


def test_every_form_names_the_protocol_and_the_number(report):
    for text in (report.to_text(), report.to_markdown()):
        assert "egocap-17: rig (head) frame, 17 joints without the head, no alignment" in text
        assert f"{report.mpjpe_mm:.1f}" in text
        assert "PCK at 20 px" in text and "shoulder" in text


def test_a_report_prints_its_summary_and_shows_as_html(report):
    text = str(report)
    assert text.startswith("egocap-17: ") and "PA-MPJPE" in text and "Error per joint" not in text
    assert len(repr(report)) < 120 and f"MPJPE {report.mpjpe_mm:.1f} mm" in repr(report)
    html = report._repr_html_()
    assert html.count("<tr>") == html.count("</tr>") > 10 and "<td>PA-MPJPE</td>" in html


def test_text_columns_line_up(report):
    lines = report.to_text().splitlines()
    start = lines.index("Error per joint, mm") + 3
    ends = {len(line) for line in lines[start + 1 : start + 9]}
    assert len(ends) == 1
    assert max(map(len, lines)) <= 100


def test_markdown_tables_are_whole(report):
    for block in report.to_markdown().split("\n\n"):
        rows = [line for line in block.splitlines() if line.startswith("|")]
        assert len({row.replace("\\|", "").count("|") for row in rows}) <= 1


def test_what_was_not_measured_is_not_shown(report):
    bare = replace(report, pck20=None, auc20=None, detections=None)
    assert "PCK at 20 px" not in bare.to_text() and "foot skate" not in bare.to_text()
    assert json.loads(bare.to_json())["pck20"] is None
