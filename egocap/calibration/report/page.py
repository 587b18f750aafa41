"""A calibration for people: lines on a terminal, and one self-contained HTML page."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

from egocap.calibration.report.advice import advice
from egocap.calibration.report.charts import draw
from egocap.calibration.report.summary import lines, summary
from egocap.calibration.rig_calibration import Calibration
from egocap.errors import InputError
from egocap.files import make_folder, write_atomically


def write_page(calibration: Calibration, path: Path) -> None:
    """Write the page. Raises InputError unless the name ends in .html, and as `disk_errors`."""
    check_page_name(path)
    make_folder(path.parent)
    write_atomically(path, render_page(calibration))


def check_page_name(path: Path) -> None:
    """Raise InputError unless a page can be written under this name."""
    if path.suffix.lower() != ".html":
        raise InputError(f"cannot write '{path.name}'", valid="a name that ends in .html")


def render_page(calibration: Calibration) -> str:
    """The page as HTML with embedded charts."""
    from jinja2 import Environment, StrictUndefined

    template = (files("egocap.calibration.report") / "page.html").read_text(encoding="utf-8")
    page = Environment(autoescape=True, undefined=StrictUndefined).from_string(template)
    return page.render(numbers=summary(calibration), advice=advice(calibration),
                       charts=draw(calibration), notes=calibration.notes)  # fmt: skip


def print_report(calibration: Calibration, out: Path, *, as_json: bool) -> None:
    """Print the numbers and the advice."""
    if as_json:
        found = summary(calibration) | {"rig": str(out), "advice": advice(calibration)}
        print(json.dumps(found, indent=1))
        return
    print("\n".join([str(out), *lines(calibration), *calibration.notes]))
    for text in advice(calibration):
        print(f"advice: {text}")
