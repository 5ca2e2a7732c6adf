"""Short HTML for notebooks: titles, tables, sections and pictures. All text is escaped here."""

from __future__ import annotations

from functools import singledispatch
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

MAX_ROWS: Final = 20  # largest number of shown rows of a table
_MAX_CELL: Final = 80  # largest number of characters in a cell
_MAX_LINES: Final = 40  # largest number of shown lines of a section
_PRE: Final = (
    '<pre style="margin:0 0 0.3em 1em;white-space:pre-wrap;word-break:normal;overflow-wrap:anywhere;line-height:1.3">'
)
_CELL: Final = '<td style="text-align:left">'
_HEAD: Final = '<th style="text-align:left">'


def escape(text: str) -> str:
    """Return text as HTML."""
    from html import escape  # noqa: PLC0415  only notebooks need it

    return escape(text)


@singledispatch
def rendered(value: object) -> str:
    """Return HTML of a value; modules register a function for each class that they can show."""
    return page(repr(value))


def page(title: str, *parts: str) -> str:
    """Return a title and parts, which are HTML."""
    return f'<div style="overflow-x:auto"><b>{escape(title)}</b>{"".join(parts)}</div>'


def table(columns: Sequence[str], rows: Sequence[Sequence[object]], limit: int = MAX_ROWS) -> str:
    """Return rows as a table; of a long table, only the first rows are shown."""
    head = "".join(f"{_HEAD}{escape(column)}</th>" for column in columns)
    body = "".join(f"<tr>{''.join(f'{_CELL}{_cell(value)}</td>' for value in row)}</tr>" for row in rows[:limit])
    more = f"<div>... {len(rows) - limit} more rows</div>" if len(rows) > limit else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


def _cell(value: object) -> str:
    text = "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
    return escape(text if len(text) <= _MAX_CELL else text[: _MAX_CELL - 3] + "...")


def vector(values: Iterable[float]) -> str:
    """Return numbers with three decimals, without trailing zeros."""
    return f"[{', '.join(f'{round(value, 3) + 0.0:g}' for value in values)}]"


def text(lines: Iterable[str]) -> str:
    """Return lines unchanged; of a long text, only the first lines are shown."""
    shown = list(lines)
    if len(shown) > _MAX_LINES:
        shown[_MAX_LINES:] = [f"... {len(shown) - _MAX_LINES} more lines"]
    return f"{_PRE}{escape(chr(10).join(shown))}</pre>" if shown else ""


def report(lines: Iterable[str], unfolded: int = 2) -> str:
    """Return a report: its first lines, then its sections. The first sections are unfolded.

    A section is an empty line, a title and indented lines.
    """
    headlines: list[str] = []
    sections: list[tuple[str, list[str]]] = []
    begins = False
    for line in lines:
        if not line:
            begins = True
        elif begins:
            sections.append((line, []))
            begins = False
        else:
            (sections[-1][1] if sections else headlines).append(line.removeprefix("  ") if sections else line)
    folds = (
        f"<details{' open' if number < unfolded else ''}><summary>{escape(title)}</summary>{text(body)}</details>"
        for number, (title, body) in enumerate(sections)
    )
    first, *more = headlines or [""]
    return page(first, text(more), *folds)


def picture(png: bytes, what: str) -> str:
    """Return a PNG as a picture."""
    from base64 import b64encode  # noqa: PLC0415  only pictures need it

    return f'<div><img src="data:image/png;base64,{b64encode(png).decode()}" alt="{escape(what)}"></div>'
