"""Cells of a page: what it tells, what a reader runs, and the output that it shows.

| block of the page | cell |
|---|---|
| `python` | runs; a `text` block after it is its output |
| any block with a `title` | a file of that name |
| `console` | commands after `$ `, each followed by its output |
| any other block | is read only |

In an output, a line `...` stands for any number of lines.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

_FENCE = re.compile(r'^```(\w+)(?: title="([^"\n]+)")?[^\n]*\n(.*?)^```\n', re.DOTALL | re.MULTILINE)


class Cell(NamedTuple):
    """A part of a page."""

    kind: str
    """`prose`, `python`, `file` or `console`."""
    source: str
    shown: str = ""
    """The output that the page shows."""
    name: str = ""
    """Name of a file."""


def cells(page: str) -> list[Cell]:
    """Return the cells of a page, which is Markdown.

    Raises:
        ValueError: a block `text` doesn't follow a block `python`.
    """
    found: list[Cell] = []
    for cell in _parts(page + "\n"):
        if cell.kind == "text":
            last = next((i for i in reversed(range(len(found))) if found[i].kind != "prose"), -1)
            if last < 0 or found[last].kind != "python" or found[last].shown:
                raise ValueError(f"no block of Python prints this:\n{cell.source}")
            found[last] = found[last]._replace(shown=cell.source)
        elif cell.kind == "prose" and found and found[-1].kind == "prose":
            found[-1] = found[-1]._replace(source=found[-1].source + cell.source)
        elif cell.source.strip():
            found.append(cell)
    return found


def _parts(page: str) -> Iterator[Cell]:
    end = 0
    for block in _FENCE.finditer(page):
        yield Cell("prose", page[end : block.start()])
        end = block.end()
        kind, name, text = block.groups()
        if name:
            yield Cell("file", text, name=name)
        elif kind == "console":
            lines = text.splitlines(keepends=True)
            yield Cell(
                "console",
                "".join(line.removeprefix("$ ") for line in lines if line.startswith("$ ")),
                "".join(line for line in lines if not line.startswith("$ ")),
            )
        elif kind in ("python", "text"):
            yield Cell(kind, text)
        else:
            yield Cell("prose", block[0])
    yield Cell("prose", page[end:])


def notebook(page: str) -> dict[str, object]:
    """Return a page as a notebook of Jupyter, without outputs."""
    made: list[dict[str, object]] = []
    for number, cell in enumerate(cells(page)):
        source = cell.source.strip()
        kind: dict[str, object] = {"cell_type": "code", "execution_count": None, "outputs": []}
        if cell.kind == "prose":
            kind = {"cell_type": "markdown"}
        elif cell.kind == "file":
            source = f"%%writefile {cell.name}\n{source}"
        elif cell.kind == "console":
            source = "\n".join(f"!{line}" for line in source.splitlines())
        made.append({**kind, "id": f"cell-{number}", "metadata": {}, "source": source})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
