"""The image model's studies, small: what they claim holds, and their pictures can be drawn."""

from pathlib import Path

import numpy as np
import pytest

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_INDEX, DOFS
from egocap.cameras.rig_files import load_rig
from egocap_eval.harness.commands import main
from egocap_eval.image_model.basin import OFFSETS_DEG, PERTURBATIONS_DEG, _summary, profile_study
from egocap_eval.image_model.exactness import KEPT, SAMPLED_RAYS, occlusion_study, quadrature_study
from egocap_eval.image_model.plots import draw
from egocap_eval.image_model.scene import Scene, Trial

RIG = load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml")


@pytest.fixture(scope="module")
def scene(tiny_sequence):
    return Scene(tiny_sequence)


def test_quadratures_converge_to_brute_force():
    found = quadrature_study(RIG, np.random.default_rng(0), rays=30)
    assert set(found) >= {"camera within 2 sigma", "coincident", "opaque", "beyond 90 degrees"}
    for name, entry in found.items():
        fine, coarse = entry["cells_5mm"]["relative"], entry["cells_20mm"]["relative"]
        if name == "coincident":  # cells are exact; what is left is brute force's own error
            assert max(fine, coarse) < 1e-5
        else:
            assert fine < 0.3 * coarse < 0.3 * 0.05
    assert found["random bodies"]["samples_9"]["relative"] < 0.01


def test_energy_and_slope_are_continuous_through_an_occlusion():
    found = occlusion_study(GaussianBody.from_proportions(Proportions.from_lengths()), RIG, 81)
    assert found["largest_energy_step_share"] < 0.1
    assert found["energy_against_slope"] < 0.005


def test_shares_of_trials():
    trials = [Trial(0.05, 0.01, 0.01), Trial(0.05, 0.04, 0.02)]
    found = _summary(trials)
    assert found["start_mm"] == 50.0 and found["median_mm"] == 25.0
    assert found["share_under_30_mm"] == 0.5 and found["share_visible_under_30_mm"] == 1.0


def test_energies_along_angles_are_lowest_near_the_truth(scene):
    found = profile_study([scene])
    (curves,) = found["scenes"].values()
    assert np.shape(curves["colour"]) == (len(DOFS), len(OFFSETS_DEG))
    middle = OFFSETS_DEG.index(0)
    elbow = curves["with_detections"][DOF_INDEX["left_shoulder_raise"]]
    assert elbow[middle] < min(elbow[0], elbow[-1])
    assert found["with_detections"]["lowest_deg"] <= found["colour"]["lowest_deg"]


def test_a_trial_starts_off_and_ends_nearer(scene):
    trial = scene.trial(5.0, np.random.default_rng(0), pixels=2.0)
    assert trial.visible > 0.0 and trial.after < trial.before


def test_pictures_of_a_result(tmp_path):
    shares = {f"samples_{n}": {"relative": 0.1 / n} for n in (3, 5)}
    curve = [[float(o * o) for o in OFFSETS_DEG]] * len(DOFS)
    summary = _summary([Trial(0.05, 0.01, 0.01)])
    result = {
        "occlusion": {"angle_deg": [0, 1], "energy": [0.0, 1.0], "slope": [1.0, 1.0]},
        "quadrature": {"random bodies": shares | {"cells_20mm": {"relative": 0.01}}},
        "stochastic": {
            f"rays_{n}_keep_{k:g}": {"scatter": 0.5, "scatter_even": 2.0}
            for n in SAMPLED_RAYS
            for k in KEPT
        },
        "basin": {"colour": {f"{size:.0f}_deg": summary for size in PERTURBATIONS_DEG}},
        "valleys": {
            "angles": list(DOFS), "offset_deg": list(OFFSETS_DEG),
            "scenes": {"walk": {"colour": curve, "with_detections": curve}},
        },
    }  # fmt: skip
    written = draw(result, tmp_path / "figure.png")
    assert [p.name for p in written] == ["figure.png", "figure-angles.png"]
    assert all(p.stat().st_size > 10_000 for p in written)


def test_a_missing_sequence_is_one_line_and_exit_code_2(tmp_path, capsys):
    assert main(["image-model", str(tmp_path / "none")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
