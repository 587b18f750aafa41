"""Tables as plain text and as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True)
class Table:
    """A table of strings; columns of numbers stand to the right, columns of words to the left."""

    title: str  # may be empty
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self) -> str:
        """Columns padded with spaces."""
        widths = [max(map(len, column)) for column in zip(self.header, *self.rows, strict=True)]
        right = self._numeric()
        lines = [_padded(row, widths, right) for row in (self.header, *self.rows)]
        rule = "-" * max(map(len, lines))
        return "\n".join(part for part in (self.title, lines[0], rule, *lines[1:]) if part)

    def markdown(self) -> str:
        """A pipe table under its title."""
        marks = tuple("---:" if right else "---" for right in self._numeric())
        lines = [f"| {' | '.join(_escaped(row))} |" for row in (self.header, marks, *self.rows)]
        return "\n".join([f"**{self.title}**", "", *lines] if self.title else lines)

    def html(self) -> str:
        """An HTML table under its title, for notebooks."""
        rows = [(self.header, "th"), *((row, "td") for row in self.rows)]
        lines = ["".join(f"<{t}>{escape(cell)}</{t}>" for cell in row) for row, t in rows]
        caption = f"<caption>{escape(self.title)}</caption>" if self.title else ""
        return f"<table>{caption}<tr>{'</tr><tr>'.join(lines)}</tr></table>"

    def _numeric(self) -> list[bool]:
        columns = list(zip(*self.rows, strict=True)) or [()] * len(self.header)
        return [bool(column) and all(map(_is_number, column)) for column in columns]


def number(value: float | None, digits: int = 1) -> str:
    """A number for a table; a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def _padded(row: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    cells = zip(row, widths, right, strict=True)
    return "  ".join(c.rjust(w) if to_right else c.ljust(w) for c, w, to_right in cells).rstrip()


def _is_number(cell: str) -> bool:
    try:
        float(cell or "0")
    except ValueError:
        return cell == "-"
    return True


def _escaped(row: Sequence[str]) -> list[str]:
    return [cell.replace("|", "\\|") for cell in row]
