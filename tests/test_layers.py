"""Imports go one way: the layers of the house, read off the source."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("egocap", "egocap_sim", "evals")

LAYERS = (
    {"errors", "geometry", "labels", "joint_names", "schema", "commandline", "arrays"},
    {"lens", "camera", "camera_files", "skeleton"},
    {
        "rig",
        "rig_files",
        "body",
        "gaussians",
        "sequence",
        "sequence_writer",
        "episodes",
        "episodes_writer",
        "results",
    },
    {"plugins"},  # what detectors and trackers from elsewhere are given
    {"detect", "track", "evaluate", "io"},  # these do not import each other
    {"posterior"},  # of a pose: the tracker's kinematics, prior and starts, sampled and bounded
    {"view", "live"},  # pictures of all of the above; all of it at once
    {"cli", "__main__"},
)
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
METHOD = 4
FOREIGN = {
    "egocap": {"egocap_sim", "evals", "benchmarks", "mujoco", "pyrender", "anny"},
    "egocap_sim": {"evals", "benchmarks"},
    "evals": {"benchmarks"},
}


def modules() -> dict[str, Path]:
    """Dotted name of every module of ours."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()
TREES = {name: ast.parse(path.read_text()) for name, path in MODULES.items()}


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
    return set(imports(name, ast.walk(TREES[name])))


def at_import(name: str) -> set[str]:
    """What importing the module imports: not within functions, not for type checkers only."""

    def reached(node: ast.AST) -> Iterator[ast.AST]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            yield child
            yield from reached(child)

    return set(imports(name, reached(TREES[name])))


def room(module: str) -> str:
    """'track' of 'egocap.track.solver'; '' of the package itself."""
    return [*module.split("."), ""][1]


def test_all_modules_are_found():
    assert {"egocap.errors", "egocap.evaluate.metrics", "evals.cli"} <= MODULES.keys()
    assert "egocap.errors" in everything("egocap.evaluate.metrics")
    assert "evals.pose" in everything("evals.cli") - at_import("evals.cli")


@pytest.mark.parametrize("name", [m for m in MODULES if m.startswith("egocap.")])
def test_lower_never_imports_higher(name):
    mine = room(name)
    assert mine in RANK, f"give egocap.{mine} its layer in this test (LAYERS)"
    for other in everything(name):
        if not other.startswith("egocap.") or room(other) == mine:
            continue
        theirs = room(other)
        assert theirs in RANK, f"give egocap.{theirs} its layer in this test (LAYERS)"
        assert RANK[theirs] <= RANK[mine], f"{name} imports {other}, which is above it"
        if RANK[mine] == METHOD:
            assert RANK[theirs] < METHOD, f"{name} imports {other}, which stands beside it"


@pytest.mark.parametrize("name", MODULES)
def test_packages_keep_apart(name):
    package = name.split(".")[0]
    tops = {other.split(".")[0] for other in everything(name)}
    assert not tops & FOREIGN[package], f"{name} imports {tops & FOREIGN[package]}"


@pytest.mark.parametrize("name", [m for m in MODULES if m.startswith("egocap_sim")])
def test_simulation_uses_only_the_nouns(name):
    for other in everything(name):
        if other.startswith("egocap."):
            assert RANK.get(room(other), METHOD) < METHOD, f"{name} imports {other}"


def test_no_import_cycle():
    graph = {name: {m for m in at_import(name) if m in MODULES} - {name} for name in MODULES}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the cycle


WITHOUT_TRUTH = ("detect", "track", "posterior")
METHOD_WITHOUT_TRUTH = [m for m in MODULES if m.startswith("egocap.") and room(m) in WITHOUT_TRUTH]


@pytest.mark.parametrize("name", METHOD_WITHOUT_TRUTH)
def test_truth_is_out_of_reach_of_detectors_and_trackers(name):
    for node in ast.walk(TREES[name]):
        assert not (isinstance(node, ast.Attribute) and node.attr == "truth"), name
        if isinstance(node, ast.ImportFrom) and node.module == "egocap.sequence":
            assert "Truth" not in {alias.name for alias in node.names}, name
