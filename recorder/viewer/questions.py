"""Reasoning queries: the last one with its answer and evidence as a page, and what it saw as a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder.log_lines import by_name, values

if TYPE_CHECKING:
    from recorder.records import Query
    from recorder.viewer.columns import Columns, Moment

QUERIES: Final = "queries"
PAGE: Final = "page"


class Questions:
    """All queries.

    Args:
        columns: where they go.
    """

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._page = columns.path(QUERIES, PAGE)

    def show(self, record: Query, now: Moment) -> None:
        """Shows a query."""
        self._columns.put(self._page, now, rr.TextDocument(_page(record), media_type="text/markdown"))


def _page(record: Query) -> str:
    failed = f"raised {record.failure.type}: {record.failure.message}" if record.HasField("failure") else ""
    lines = [
        f"## {record.name}({values(record.arguments)})",
        f"**{failed or by_name(record.answer_json)}**",
        "",
        f"asked at step {record.seq} of {record.world}, took {record.duration_ns / 1e6:.1f} ms",
        "",
        "| evidence | |",
        "|---|---|",
        *(f"| {one.name} | {by_name(one.json)} |" for one in record.evidence),
    ]
    return "\n".join(lines)
