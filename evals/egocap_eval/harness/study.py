"""Run a study as a command: options in; printed tables and one result file out.

A study is a module with a function `study`, named in `egocap_eval.harness.commands`. Its parameters
(with defaults, and an `Args:` section in the docstring) become the options of `egocap-eval NAME`;
it returns an `Outcome` and neither prints nor writes results. The options --json, --markdown and
--out are added here, as is the record of command, configuration, machine, versions and time.
"""

from __future__ import annotations

import functools
import inspect
import json as json_format
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from tyro.conf import arg

from egocap.commandline import DONE, MISSED
from egocap.errors import InputError
from egocap.evaluation.table import Table
from egocap_eval.harness.result_file import code_stamp, plain, save_result, write_text

FORMATS = (".json", ".md", ".txt")

_COMMON_HELP = """json: Print JSON instead of tables.
    markdown: Print Markdown instead of tables.
    out: Write the result there too: .json (with command, commit, machine, time), .md or .txt."""


@dataclass(frozen=True)
class Outcome:
    """What a study found.

    `config` holds whatever the numbers depend on beyond the command's own options (a tracker's
    settings, hashes of sequences, of weights); the options themselves are recorded anyway.
    """

    result: Mapping[str, Any]  # JSON-ready, no NaN: None for what could not be measured
    tables: Sequence[Table] = ()
    missed: Sequence[str] = ()  # targets that were not met, in words: exit code 3
    config: Mapping[str, Any] = field(default_factory=dict)  # JSON-ready
    heading: str = ""  # above the tables

    def to_json(self) -> str:
        """The result as text."""
        return json_format.dumps(self.result, indent=2, allow_nan=False)

    def to_text(self) -> str:
        """Tables for a terminal."""
        return "\n\n".join(filter(None, [self.heading, *(t.text() for t in self.tables)]))

    def to_markdown(self) -> str:
        """Tables as Markdown."""
        return "\n\n".join(filter(None, [self.heading, *(t.markdown() for t in self.tables)]))


def as_command(
    study: Callable[..., Outcome], name: str, words: Sequence[str]
) -> Callable[..., int]:
    """The study as a function for the command line, with --json, --markdown and --out.

    `words` is the command line after `egocap-eval`, for the record.
    """
    hints = get_type_hints(study, include_extras=True)
    signature = inspect.signature(study)
    flag = Annotated[bool, arg(help_behavior_hint="")]
    hints = {name: flag if hint is bool else hint for name, hint in hints.items()}
    own = [p.replace(annotation=hints[p.name]) for p in signature.parameters.values()]
    path = Annotated[Path | None, arg(metavar="FILE")]
    kind = inspect.Parameter.KEYWORD_ONLY
    common = [
        inspect.Parameter("json", kind, default=False, annotation=flag),
        inspect.Parameter("markdown", kind, default=False, annotation=flag),
        inspect.Parameter("out", kind, default=None, annotation=path),
    ]

    @functools.wraps(study)
    def command(*args: Any, **options: Any) -> int:
        json, markdown, out = (options.pop(p.name) for p in common)
        _check_output(json, markdown, out)
        stamp = code_stamp(f"egocap-eval {name}") if out is not None else {}
        wall, cpu = time.perf_counter(), time.process_time()
        outcome = study(*args, **options)
        spent = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
        given = signature.bind(*args, **options).arguments
        if out is not None:
            _write(out, outcome, ["egocap-eval", *words], given, spent, stamp)
        print(outcome.to_json() if json else outcome.to_markdown() if markdown
              else outcome.to_text())  # fmt: skip
        for what in outcome.missed:
            print(f"missed: {what}", file=sys.stderr)
        return MISSED if outcome.missed else DONE

    command.__name__ = name
    command.__signature__ = signature.replace(parameters=[*own, *common])  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in [*own, *common]}
    command.__doc__ = _with_common_help(inspect.getdoc(study) or "")
    del command.__wrapped__  # or the study's own signature would be read through it
    return command


def _check_output(json: bool, markdown: bool, out: Path | None) -> None:
    if json and markdown:
        raise InputError("--json and --markdown exclude each other", valid="one of them")
    if out is not None and out.suffix not in FORMATS:
        raise InputError(f"--out {out}: no format for '{out.suffix}'", valid=FORMATS)


def _write(
    path: Path, outcome: Outcome, words: Sequence[str], options: Mapping[str, Any],
    seconds: Mapping[str, float], stamp: Mapping[str, Any],
) -> None:  # fmt: skip
    if path.suffix == ".json":
        config = {"options": plain(options), **outcome.config}
        result = {**outcome.result, "missed": list(outcome.missed)}
        save_result(path, result, shlex.join(words), config=config, seconds=seconds,
                    stamp=stamp)  # fmt: skip
    else:
        text = outcome.to_markdown() if path.suffix == ".md" else outcome.to_text()
        write_text(path, text + "\n")


def _with_common_help(doc: str) -> str:
    head = doc if "Args:" in doc else f"{doc}\n\nArgs:"
    return f"{head.rstrip()}\n    {_COMMON_HELP}\n"
