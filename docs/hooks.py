"""MkDocs hook: write reference/commands.md from the help texts of the three commands."""

import io
import os
import re
import sys
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path

PROGRAMS = {
    "egocap": "egocap.cli",
    "egocap-sim": "egocap_sim.cli",
    "egocap-eval": "egocap_eval.cli",
}
INTRODUCTION = """\
Written from the commands' own `--help`. Exit codes: 0 done, 1 failed, 2 usage or bad file,
3 a threshold was missed, 130 interrupted."""
SUBCOMMAND = re.compile(r"^\W+([a-z][a-z-]+)(?: {2}|\s*$)", re.MULTILINE)


def help_text(program: str, *words: str) -> str:
    """What `program WORDS --help` prints, 100 columns wide and without colour."""
    os.environ |= {"NO_COLOR": "1", "COLUMNS": "100", "TERM": "dumb"}
    main = import_module(PROGRAMS[program]).main
    printed, arguments = io.StringIO(), sys.argv
    sys.argv = [program, *words, "--help"]
    try:
        with redirect_stdout(printed):
            main()
    except SystemExit:
        pass
    finally:
        sys.argv = arguments
    return "\n".join(line.rstrip() for line in printed.getvalue().strip().splitlines())


def subcommands(program: str, *words: str) -> list[str]:
    """Names of the subcommands of a program or command, in the order of its help."""
    listed = help_text(program, *words).partition("subcommands")[2]
    return list(dict.fromkeys(SUBCOMMAND.findall(listed)))


def commands_page() -> str:
    """The page, as Markdown."""
    parts = ["# Commands", INTRODUCTION]
    for program in PROGRAMS:
        parts += [f"## {program}", f"```text\n{help_text(program)}\n```"]
        for name in subcommands(program):
            parts += [f"### {program} {name}", f"```text\n{help_text(program, name)}\n```"]
            for inner in subcommands(program, name):
                text = help_text(program, name, inner)
                parts += [f"#### {program} {name} {inner}", f"```text\n{text}\n```"]
    return "\n\n".join(parts) + "\n"


def on_pre_build(config) -> None:
    """Write the page before MkDocs reads the folder."""
    page = Path(config["docs_dir"]) / "reference" / "commands.md"
    text = commands_page()
    if not page.is_file() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")
