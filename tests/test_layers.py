"""The layout, read off the source: imports go one way between rooms and never in a circle."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {"egocap": ROOT, "egocap_sim": ROOT, "egocap_eval": ROOT / "evals"}
MOST_MODULES = 20
"""In one folder, its `__init__` not counted."""

LAYERS = (
    {"egocap.errors", "egocap.geometry", "egocap.options", "egocap.series"},
    {"egocap.files"},
    {"egocap.schema", "egocap.commandline", "egocap.workers"},
    {"egocap.locks"},
    {"egocap.cameras", "egocap.body", "egocap.media", "egocap.boards", "egocap.storage"},
    {"egocap.data"},
    {"egocap.execution"},
    {"egocap.export"},
    {"egocap.footage", "egocap.calibration", "egocap.odometry", "egocap.world"},
    {"egocap.detect", "egocap.evaluation", "egocap.pose", "egocap.head_pose"},  # not each other
    {"egocap.detect.train", "egocap.image_model", "egocap.consistency"},
    {"egocap.appearance"},
    {"egocap.track", "egocap.datasets"},
    {"egocap.paper", "egocap.fitting", "egocap.posterior"},
    {"egocap.view"},
    {"egocap.motion_capture"},
    {"egocap.adaptation"},
    {"egocap.cli"},
    {"egocap.__main__"},
)
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
NOUNS = RANK["egocap.execution"]  # the highest layer that the simulator may use
FOREIGN = {
    "egocap": {"egocap_sim", "egocap_eval", "benchmarks", "mujoco", "OpenGL", "anny"},
    "egocap_sim": {"egocap_eval", "benchmarks"},
    "egocap_eval": {"benchmarks"},
}


def modules() -> dict[str, Path]:
    """Dotted name of every module of ours."""
    found = {}
    for package, root in PACKAGES.items():
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()
TREES = {name: ast.parse(path.read_text()) for name, path in MODULES.items()}
ROOMS = {name for name, path in MODULES.items() if path.name == "__init__.py"}


def imports(name: str, nodes: Iterator[ast.AST]) -> Iterator[str]:
    """Dotted names of the modules that these nodes import."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import in line {node.lineno}"
            assert node.module
            submodules = [f"{node.module}.{alias.name}" for alias in node.names]
            inner = [m for m in submodules if m in MODULES]
            yield from inner
            if len(inner) < len(submodules) or not inner:
                yield node.module


def everything(name: str) -> set[str]:
    """What a module imports anywhere: imports inside functions and for type checkers included."""
    return set(imports(name, ast.walk(TREES[name])))


def room(module: str) -> str:
    """'egocap.track' of 'egocap.track.tracker'; a module without a room is its own."""
    while module not in RANK and "." in module:
        module = module.rpartition(".")[0]
    return module


def circle(graph: dict[str, set[str]]) -> None:
    """Raises graphlib.CycleError, which names the circle, if there is one."""
    TopologicalSorter(graph).prepare()


def test_all_modules_are_found():
    assert {"egocap.errors", "egocap.evaluation.metrics", "egocap_eval.cli"} <= MODULES.keys()
    assert "egocap.errors" in everything("egocap.evaluation.metrics")
    assert "egocap_eval.harness.commands" in everything("egocap_eval.cli")


@pytest.mark.parametrize("name", [m for m in MODULES if m.startswith("egocap.")])
def test_lower_never_imports_higher(name):
    mine = room(name)
    assert mine in RANK, f"give {mine} its layer in this test (LAYERS)"
    for other in everything(name):
        theirs = room(other)
        if not other.startswith("egocap.") or theirs == mine:
            continue
        assert theirs in RANK, f"give {theirs} its layer in this test (LAYERS)"
        assert RANK[theirs] < RANK[mine], f"{name} imports {other}, which is not below it"


@pytest.mark.parametrize("name", MODULES)
def test_packages_keep_apart(name):
    package = name.split(".")[0]
    tops = {other.split(".")[0] for other in everything(name)}
    assert not tops & FOREIGN[package], f"{name} imports {tops & FOREIGN[package]}"


@pytest.mark.parametrize("name", [m for m in MODULES if m.startswith("egocap_sim")])
def test_simulation_uses_only_the_nouns(name):
    for other in everything(name):
        if other.startswith("egocap."):
            assert RANK[room(other)] <= NOUNS, f"{name} imports {other}"


def test_no_module_circle():
    circle({name: {m for m in everything(name) if m in MODULES} - {name} for name in MODULES})


def test_no_room_circle():
    """Neither between folders: what flows between two rooms flows one way."""
    graph: dict[str, set[str]] = {}
    for name in MODULES.keys() - ROOMS:
        mine = name.rpartition(".")[0]
        theirs = {m.rpartition(".")[0] for m in everything(name) if m in MODULES and m not in ROOMS}
        if mine not in PACKAGES:
            graph.setdefault(mine, set()).update(theirs - {mine, *PACKAGES})
    circle(graph)


@pytest.mark.parametrize("name", MODULES)
def test_no_command_line_is_imported(name):
    for other in everything(name):
        parts = other.split(".")
        if len(parts) > 1 and parts[1] == "cli":
            mine = name.split(".")
            assert mine[0] == parts[0], f"{name} imports {other}"
            assert mine[1] in ("cli", "__main__"), f"{name} imports {other}"


@pytest.mark.parametrize("name", sorted(ROOMS))
def test_rooms_are_small_and_say_what_they_are(name):
    here = [m for m in MODULES if m.rpartition(".")[0] == name and m not in ROOMS]
    assert len(here) <= MOST_MODULES, f"{name} holds {len(here)} modules"
    told = ast.get_docstring(TREES[name])
    assert told and len(told.splitlines()) >= 2, f"{name} does not say what comes in and goes out"


HANDS_TRUTH_ON = {"egocap.detect.sources"}  # to the synthetic detector alone
WITHOUT_TRUTH = ("detect", "odometry", "head_pose", "world", "pose", "image_model", "track",
                 "paper", "fitting", "posterior")  # fmt: skip
METHOD_WITHOUT_TRUTH = [
    m
    for m in MODULES
    if m.startswith("egocap.") and m.split(".")[1] in WITHOUT_TRUTH and m not in HANDS_TRUTH_ON
]


@pytest.mark.parametrize("name", METHOD_WITHOUT_TRUTH)
def test_truth_is_out_of_reach_of_detectors_and_trackers(name):
    for node in ast.walk(TREES[name]):
        assert not (isinstance(node, ast.Attribute) and node.attr == "truth"), name
        if isinstance(node, ast.ImportFrom) and node.module == "egocap.data.truth":
            assert "Truth" not in {alias.name for alias in node.names}, name
