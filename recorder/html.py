"""Short HTML for notebooks: titles, tables, sections and pictures. These functions escape all text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import singledispatch
from html import escape
from typing import Final

MAX_ROWS: Final = 20  # maximum number of rows in a table
_MAX_CELL: Final = 80  # maximum number of characters in a cell
_MAX_LINES: Final = 40  # maximum number of lines in a section
_PRE: Final = (
    '<pre style="margin:0 0 0.3em 1em;white-space:pre-wrap;word-break:normal;overflow-wrap:anywhere;line-height:1.3">'
)
_CELL: Final = '<td style="text-align:left">'
_HEAD: Final = '<th style="text-align:left">'


@singledispatch
def rendered(value: object) -> str:
    """Return the HTML of a value. Each module registers functions for its classes."""
    return page(repr(value))


def page(title: str, *parts: str) -> str:
    """Return the HTML of a page with a title. The parts are already HTML."""
    return f'<div style="overflow-x:auto"><b>{escape(title)}</b>{"".join(parts)}</div>'


def table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return the HTML of a table with the first 20 rows."""
    head = "".join(f"{_HEAD}{escape(column)}</th>" for column in columns)
    body = "".join(f"<tr>{''.join(f'{_CELL}{_cell(value)}</td>' for value in row)}</tr>" for row in rows[:MAX_ROWS])
    more = f"<div>... {len(rows) - MAX_ROWS} more rows</div>" if len(rows) > MAX_ROWS else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


def _cell(value: object) -> str:
    text = "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
    return escape(text if len(text) <= _MAX_CELL else text[: _MAX_CELL - 3] + "...")


def vector(values: Iterable[float]) -> str:
    """Return "[1.5, 2, 0.333]": numbers with at most three decimals."""
    return f"[{', '.join(f'{round(value, 3) + 0.0:g}' for value in values)}]"


def text(lines: Iterable[str]) -> str:
    """Return the HTML of the first lines of a text."""
    shown = list(lines)
    if len(shown) > _MAX_LINES:
        shown[_MAX_LINES:] = [f"... {len(shown) - _MAX_LINES} more lines"]
    return f"{_PRE}{escape(chr(10).join(shown))}</pre>" if shown else ""


def sections(lines: Iterable[str]) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Return the first lines of a report, and its sections; a section is an empty line, a title and indented lines."""
    headlines: list[str] = []
    found: list[tuple[str, list[str]]] = []
    begins = False
    for line in lines:
        if not line:
            begins = True
        elif begins:
            found.append((line, []))
            begins = False
        else:
            (found[-1][1] if found else headlines).append(line.removeprefix("  ") if found else line)
    return headlines, found


def report(lines: Iterable[str]) -> str:
    """Return the HTML of a report, with the first two sections open."""
    headlines, found = sections(lines)
    folds = (
        f"<details{' open' if number < 2 else ''}><summary>{escape(title)}</summary>{text(body)}</details>"
        for number, (title, body) in enumerate(found)
    )
    first, *more = headlines or [""]
    return page(first, text(more), *folds)


def picture(png: bytes, what: str) -> str:
    """Return the HTML of a PNG picture."""
    from base64 import b64encode  # noqa: PLC0415  imported here: only pictures need it

    return f'<div><img src="data:image/png;base64,{b64encode(png).decode()}" alt="{escape(what)}"></div>'
