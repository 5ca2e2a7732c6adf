"""The last reasoning query as a page: what was asked, the answer and its evidence."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa
import rerun as rr

from recorder.records import format_failure
from recorder.records.choices import rejection_lines
from recorder.records.text import by_name, values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records import Query
    from recorder.viewer.columns import Columns, TimePoint

QUERIES: Final = "queries"
PAGE: Final = "page"
_ACTIVE: Final = re.compile(r"\\|(?<=!)\[|(?<=\])[\[(]|<")


class QueryPage:
    """Page of the last query."""

    def __init__(self, columns: Columns) -> None:
        self._pages = columns.series(columns.path(QUERIES, PAGE), _pages)

    def show(self, record: Query, now: TimePoint) -> None:
        """Shows a query."""
        self._pages.add(now, (_page(record),))


def _pages(rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    text = pa.array([text for (text,) in rows])
    return rr.TextDocument.columns(text=text, media_type=pa.repeat("text/markdown", len(rows)))


def _page(record: Query) -> str:
    raised = f"raised {format_failure(record.failure)}" if record.HasField("failure") else ""
    lines = [
        _text(f"## {record.name}({values(record.arguments)})"),
        _text(f"**{raised or by_name(record.answer_json)}**"),
        "",
        _text(f"asked at step {record.seq} of {record.world}, took {record.duration_ns / 1e6:.1f} ms"),
        "",
        "| evidence | |",
        "|---|---|",
        *[f"| {_cell(fact.name)} | {_cell(by_name(fact.json))} |" for fact in record.evidence[:]],
        *[f"| rejected | {_cell(line)} |" for line in rejection_lines(record)],
    ]
    return "\n".join(lines)


def _cell(text: str) -> str:
    return _text(text).replace("|", "\\|")


def _text(line: str) -> str:
    """A line of a stranger's recording: viewers would fetch the pictures that Markdown names from wherever they are."""
    return _ACTIVE.sub(r"\\\g<0>", " ".join(line.splitlines()))
