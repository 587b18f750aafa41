"""README and docs: their Python runs, their commands exist, their links lead somewhere."""

import importlib
import importlib.util
import os
import re
import shlex
from functools import cache, partial
from pathlib import Path

import pytest

pytestmark = pytest.mark.long
ROOT = Path(__file__).parents[1]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *(ROOT / folder / "README.md" for folder in ("evals", "scenes", "examples")),
]
BLOCK = re.compile(r"^```(\w+)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
SMALL_RIG = """
name = "my_rig"
[lens]
model = "equidistant"
width = 256
height = 208
fov = 180.0
[stereo]
baseline = 0.35
forward = 0.37
up = 0.14
pitch = 90.0
"""


def blocks(page: Path, language: str) -> list[str]:
    return [text for name, text in BLOCK.findall(page.read_text()) if name == language]


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def commands(page: Path) -> list[list[str]]:
    """Words of every line in a shell block, or indented by four, that calls one of our commands."""
    text = page.read_text()
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    lines += [line for line in text.splitlines() if line.startswith("    egocap")]
    lines += [found for found in re.findall(r"`(egocap[a-z-]* [^`]*)`", text) if "SEQ" not in found]
    calls = [call.strip() for line in lines for call in line.split("&&")]
    return [shlex.split(c, comments=True) for c in calls if re.match(r"egocap\S* [a-z]", c)]


@cache
def hooks():
    spec = importlib.util.spec_from_file_location("docs_hooks", ROOT / "docs" / "hooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _of_torch() -> str:
    """Commands that train have no help where torch, an extra, is not installed."""
    pytest.importorskip("torch")
    return ""


@cache
def help_of(program: str, *words: str) -> str:
    environment = dict(os.environ)
    try:
        return hooks().help_text(program, *words) or _of_torch()
    finally:
        os.environ.clear()
        os.environ.update(environment)


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=name_of)
def test_python_runs_as_it_stands(page, tmp_path, monkeypatch, small_walk):
    """Every block of a page, one after the other, in a folder with a rig file and out/walk.

    Of what README generates, the first frames.
    """
    import egocap_sim

    monkeypatch.setattr(egocap_sim, "generate", partial(egocap_sim.generate, frames=30))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_rig.toml").write_text(SMALL_RIG)
    (tmp_path / "out").mkdir()
    if page.name != "README.md":  # README makes its own
        (tmp_path / "out" / "walk").symlink_to(small_walk)
    names: dict[str, object] = {}
    for text in blocks(page, "python"):
        exec(compile(text, f"{name_of(page)}", "exec"), names)


@pytest.fixture(scope="session")
def small_walk(tmp_path_factory):
    import egocap_sim

    folder = tmp_path_factory.mktemp("docs")
    (folder / "rig.toml").write_text(SMALL_RIG)
    egocap_sim.generate("validation-walk", folder / "walk", rig=folder / "rig.toml", frames=12)
    return folder / "walk"


@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=name_of)
def test_commands_and_options_exist(page):
    for program, name, *words in commands(page):
        assert name in hooks().subcommands(program), f"{program} {name}"
        advanced = ["--advanced"] if "--advanced" in help_of(program, name) else []
        told = help_of(program, name) + help_of(program, name, *advanced)
        if words and words[0] in hooks().subcommands(program, name):
            told = help_of(program, name, words[0])
        for word in words:
            if word.startswith("--"):
                option = word.partition("=")[0]
                assert re.search(rf"{option}(?![\w-])", told), f"{program} {name} has no {option}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    for target in LINK.findall(page.read_text()):
        if re.match(r"https?://|mailto:", target):
            continue
        file, _, anchor = target.partition("#")
        path = (page.parent / file).resolve() if file else page
        if file.endswith("reference/commands.md"):
            continue  # written by `make docs`
        assert path.exists(), f"{target} does not exist"
        if anchor:
            heads = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
            slugs = {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}
            assert anchor in slugs, f"{target}: no such heading"


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120


def test_the_reference_names_what_exists():
    for name in re.findall(r"^::: (\S+)$", (ROOT / "docs/reference/api.md").read_text(), re.M):
        module, _, attribute = name.rpartition(".")
        assert hasattr(importlib.import_module(module), attribute), name
