"""Write the tables of README and docs between their markers, from the results of `evals/results`.

<!-- table NAME -->
...
<!-- end -->
"""

from __future__ import annotations

import re
from pathlib import Path

from egocap.errors import FileError
from egocap.files import write_atomically
from egocap_eval.evidence.page_table import Results
from egocap_eval.evidence.registry import ROOT
from egocap_eval.evidence.result_tables import TABLES
from egocap_eval.harness.study import Outcome

PAGES = (
    "README.md", "docs/results.md", "docs/paper.md", "docs/how-to/scale.md", "evals/README.md"
)  # fmt: skip
BLOCK = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def study(check: bool = False) -> Outcome:
    """Write the tables of README and docs from the results.

    Args:
        check: Write nothing; exit code 3 if a table differs from its results.
    """
    changed = []
    for page in PAGES:
        path = ROOT / page
        if not path.is_file():
            raise FileError(path, "no such page", valid="a checkout of the repository")
        before = path.read_text(encoding="utf-8")
        after = with_tables(before, path, Results())
        if after != before:
            changed.append(page)
            if not check:
                write_atomically(path, after)
    missed = [f"{page} differs from evals/results; make tables" for page in changed]
    return Outcome({"changed": changed}, missed=missed if check else ())


def with_tables(text: str, where: Path, results: Results) -> str:
    """A page's text with the tables of its markers. Raises FileError for an unknown table."""

    def block(found: re.Match[str]) -> str:
        start, name, end = found.groups()
        if name not in TABLES:
            raise FileError(where, f"no table '{name}'", valid=list(TABLES))
        return f"{start}\n{TABLES[name](results)}\n{end}"

    return BLOCK.sub(block, text)
