"""Run mutmut on the formula modules, each against its own tests, and write the scores.

    python tools/mutation.py WORK [MODULE ...] [--out evals/results/mutation.json]

WORK holds a copy of the source; finished modules are kept there, and the same command continues.
A mutant is killed when a test fails or does not end. Survivors are listed with their change.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MODULES: dict[str, tuple[str, ...]] = {
    "egocap/cameras/lens.py": ("tests/egocap/cameras/test_lens.py",
                               "tests/egocap/cameras/test_camera.py"),
    "egocap/cameras/camera.py": ("tests/egocap/cameras/test_camera.py",),
    "egocap/image_model/colour_measure.py": ("tests/egocap/image_model/test_colour_measure.py",),
    "egocap/pose/energy.py": ("tests/egocap/pose/test_energy.py",),
    "egocap/evaluation/metrics.py": ("tests/egocap/evaluation/test_metrics.py",
                                     "tests/egocap/evaluation/test_foot_contact.py"),
    "egocap/evaluation/alignment.py": ("tests/egocap/evaluation/test_alignment.py",),
    "egocap/posterior/information.py": ("tests/egocap/posterior/test_information.py",),
}  # fmt: skip
"""Modules and the tests that must notice their mutants."""
SETTINGS = """[tool.mutmut]
source_paths = ["egocap"]
only_mutate = ["{module}"]
also_copy = ["evals", "egocap_sim", "scenes", "tests", "pyproject.toml"]
pytest_add_cli_args_test_selection = {tests}
pytest_add_cli_args = ["-p", "no:cacheprovider", "-p", "no:xdist"]
"""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("work", type=Path)
    parser.add_argument("modules", nargs="*", default=list(MODULES))
    parser.add_argument("--out", type=Path, default=ROOT / "evals/results/mutation.json")
    parser.add_argument("--children", type=int, default=2)
    options = parser.parse_args()
    for module in options.modules:
        kept = options.work / (module.replace("/", ".") + ".json")
        if not kept.exists():
            found = mutate(module, options.work / "source", options.children)
            kept.write_text(json.dumps(found, indent=1))
        print(module, json.loads(kept.read_text())["score"], flush=True)
    found = {m: json.loads(p.read_text()) for m in MODULES
             if (p := options.work / (m.replace("/", ".") + ".json")).exists()}  # fmt: skip
    write(options.out, found)


def mutate(module: str, work: Path, children: int) -> dict[str, object]:
    """Killed and surviving mutants of a module."""
    shutil.rmtree(work, ignore_errors=True)
    keep = shutil.ignore_patterns("__pycache__", ".git", "out", "results")
    for part in ("egocap", "egocap_sim", "evals", "scenes", "tests"):
        shutil.copytree(ROOT / part, work / part, ignore=keep)
    settings = SETTINGS.format(module=module, tests=json.dumps(list(MODULES[module])))
    (work / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text() + "\n" + settings)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    command = [sys.executable, "-m", "mutmut"]
    subprocess.run([*command, "run", "--max-children", str(children)], cwd=work, env=environment,
                   check=True)  # fmt: skip
    told = subprocess.run([*command, "results", "--all", "true"], cwd=work, env=environment,
                          check=True, capture_output=True, text=True).stdout  # fmt: skip
    status = dict(line.strip().rsplit(": ", 1) for line in told.splitlines() if ": " in line)
    survivors = {name: change(work, name, environment) for name, state in status.items()
                 if state in ("survived", "no tests")}  # fmt: skip
    killed = len(status) - len(survivors)
    return {"mutants": len(status), "killed": killed, "survivors": survivors,
            "score": round(killed / max(len(status), 1), 4)}  # fmt: skip


def change(work: Path, name: str, environment: dict[str, str]) -> list[str]:
    """The lines that a mutant takes away and adds."""
    command = [sys.executable, "-m", "mutmut", "show", name]
    shown = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True)
    lines = shown.stdout.splitlines()
    return [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]


def write(path: Path, found: dict[str, dict[str, object]]) -> None:
    """Write the scores with commit and command."""
    sys.path[:0] = [str(ROOT), str(ROOT / "evals")]
    from egocap_eval.harness.result_file import save_result

    save_result(path, {"modules": found}, "python tools/mutation.py WORK")


if __name__ == "__main__":
    main()
