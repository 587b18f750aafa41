"""What an installed package holds: modules and their data, and no package named `evals`."""

import tomllib
from importlib.resources import files
from pathlib import Path

from egocap_eval.harness import thresholds
from egocap_eval.harness.suite import FOLDER
from egocap_eval.harness.thresholds import NOT_HERE, Numbers

ROOT = Path(__file__).parents[2]
WHEEL = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"][
    "wheel"
]


def test_the_wheel_has_three_packages_and_the_scenes():
    names = [Path(package).name for package in WHEEL["packages"]]
    assert names == ["egocap", "egocap_sim", "egocap_eval"]
    assert all((ROOT / package / "__init__.py").is_file() for package in WHEEL["packages"])
    assert WHEEL["force-include"] == {"scenes": "egocap_sim/scenes"}


def test_data_of_the_commands_lies_in_the_package():
    package = files("egocap_eval")
    assert Path(str(package)).joinpath("suites") == FOLDER
    for name in ("suites/quick.toml", "suites/paper.toml", "baselines/ci.json",
                 "harness/report.html", "harness/viewer.js"):  # fmt: skip
        assert package.joinpath(name).is_file(), name


def test_numbers_without_the_committed_results_give_the_reason(monkeypatch, tmp_path):
    monkeypatch.setattr(thresholds, "COMMITTED", tmp_path / "results")
    assert Numbers({}, tmp_path).find("stress.json:best_baseline.best") == (None, NOT_HERE)
