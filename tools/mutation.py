"""Run mutmut on the formula modules, each against its own tests, and write the scores.

    python tools/mutation.py WORK [MODULE ...] [--out evals/results/mutation.json]

WORK holds a copy of the source; finished modules are kept there until their code or tests change,
and the same command continues. A mutant is killed when a test fails or does not end. Survivors are
listed with their change. Those that `mutation-equivalents.toml` explains, as changes that no input
can show, are listed apart, and each score is given with and without them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "evals")]

from egocap_eval.harness.result_file import save_result  # noqa: E402
from egocap_eval.harness.study_sources import FORMULA_TESTS as MODULES  # noqa: E402

EQUIVALENTS = Path(__file__).with_name("mutation-equivalents.toml")
LEAST = 0.9
"""Target of every module's score, with the explained equivalents counted as survivors."""
KILLED = ("killed", "timeout", "segfault")
"""States of mutants that the tests noticed; every other state counts as survived."""
SETTINGS = """[tool.mutmut]
source_paths = ["egocap"]
only_mutate = ["{module}"]
also_copy = ["evals", "egocap_sim", "scenes", "tests", "pyproject.toml"]
pytest_add_cli_args_test_selection = {tests}
pytest_add_cli_args = ["-p", "no:cacheprovider", "-p", "no:xdist"]
"""
SHOW = """
import json, sys
from mutmut.mutation.diff_apply import get_diff_for_mutant
print(json.dumps({name: get_diff_for_mutant(name) for name in sys.argv[1:]}))
"""
"""`mutmut show` of many mutants in one process."""


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
        if kept(options.work, module) is None:
            found = mutate(module, options.work / "source", options.children)
            path_of(options.work, module).write_text(json.dumps(found, indent=1))
    explained = tomllib.loads(EQUIVALENTS.read_text(encoding="utf-8"))
    results, unused = {}, []
    for module in MODULES:
        if (found := kept(options.work, module)) is not None:
            results[module], missing = judge(found, explained.get(module, []))
            unused += [f"{module}, {entry['function']}: {entry['change']}" for entry in missing]
            raw, adjusted = (100.0 * results[module][key] for key in ("score", "adjusted"))
            print(f"{module}: {raw:.1f} % raw, {adjusted:.1f} % without explained equivalents")
    missed = [f"{module}: {100.0 * r['score']:.1f} % of the mutants killed, not {100.0 * LEAST:.0f}"
              for module, r in results.items() if r["score"] < LEAST]  # fmt: skip
    save_result(
        options.out,
        {"modules": results, "total": total(results), "missed": missed},
        "python tools/mutation.py WORK/mutation",
    )
    if unused:
        sys.exit("explained, but not among the survivors:\n" + "\n".join(unused))


def path_of(work: Path, module: str) -> Path:
    """Where a module's outcome is kept."""
    return work / (module.replace("/", ".") + ".json")


def kept(work: Path, module: str) -> dict[str, Any] | None:
    """A module's finished outcome; None if there is none of the present code and tests."""
    path = path_of(work, module)
    found = json.loads(path.read_text()) if path.exists() else {}
    return found if found.get("inputs") == inputs(module) else None


def inputs(module: str) -> str:
    """Hash of a module and its tests."""
    content = b"".join((ROOT / name).read_bytes() for name in (module, *MODULES[module]))
    return hashlib.sha256(content).hexdigest()


def mutate(module: str, work: Path, children: int) -> dict[str, Any]:
    """Number of a module's mutants, and the survivors with their changes."""
    shutil.rmtree(work, ignore_errors=True)
    keep = shutil.ignore_patterns("__pycache__", ".git", "out", "results")
    before = inputs(module)
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
    states = dict(line.strip().rsplit(": ", 1) for line in told.splitlines() if ": " in line)
    alive = {name: state for name, state in states.items() if state not in KILLED}
    changed = changes(work, list(alive), environment)
    survivors = {name: {"state": alive[name], "change": changed[name]} for name in alive}
    return {"inputs": before, "mutants": len(states), "survivors": survivors}


def changes(work: Path, names: list[str], environment: dict[str, str]) -> dict[str, list[str]]:
    """The lines that each mutant takes away and adds."""
    told = subprocess.run([sys.executable, "-c", SHOW, *names], cwd=work, env=environment,
                          check=True, capture_output=True, text=True).stdout  # fmt: skip
    return {name: [line for line in text.splitlines()
                   if line[:1] in ("+", "-") and line[:3] not in ("+++", "---")]
            for name, text in json.loads(told).items()}  # fmt: skip


def judge(
    found: dict[str, Any], explained: list[dict[str, str]]
) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """A module's scores and its survivors, unexplained and explained; explanations of no survivor.

    An explanation names the function, and the change as it is listed, up to indentation.
    """
    unused, open_, equivalent = list(explained), {}, {}
    for name, survivor in found["survivors"].items():
        lines = unindented(survivor["change"])
        same = [entry for entry in explained
                if entry["function"] == function_of(name)
                and lines == unindented(entry["change"].strip().splitlines())]  # fmt: skip
        unused = [entry for entry in unused if entry not in same]
        if same:
            equivalent[name] = {"change": survivor["change"], "reason": same[0]["reason"]}
        else:
            open_[name] = survivor
    counts = {"mutants": found["mutants"], "killed": found["mutants"] - len(found["survivors"]),
              "equivalent": len(equivalent)}  # fmt: skip
    return {**counts, **scores(counts), "survivors": open_, "equivalents": equivalent}, unused


def unindented(change: list[str]) -> list[str]:
    """Lines that begin with + or -, without their indentation."""
    return [line[0] + line[1:].strip() for line in change]


def function_of(mutant: str) -> str:
    """`name` or `Class.name` from the dotted name of a mutant (`x_name__mutmut_1`)."""
    name = re.sub(r"__mutmut_\d+$", "", mutant.rsplit(".", 1)[1])
    return name[2:] if name.startswith("x_") else name[1:].strip("ǁ").replace("ǁ", ".")


def scores(counts: dict[str, int]) -> dict[str, float]:
    """Killed share of all mutants, and of those that are not explained as equivalent."""
    killed, mutants = counts["killed"], counts["mutants"]
    return {"score": round(killed / max(mutants, 1), 4),
            "adjusted": round(killed / max(mutants - counts["equivalent"], 1), 4)}  # fmt: skip


def total(results: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Counts and scores of all modules together."""
    counts = {key: sum(r[key] for r in results.values())
              for key in ("mutants", "killed", "equivalent")}  # fmt: skip
    return {**counts, **scores(counts)}


if __name__ == "__main__":
    main()
