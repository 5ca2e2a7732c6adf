"""A recording as text and tables: log lines, tables, the last query, and tasks as timeline and graph. Needs no scene.

Log lines have levels, and one entity for each kind of record, so that kinds can be hidden. They begin with the step,
which is what people type: the viewer's own column of times has room for two digits, and shows another time line when
one is chosen.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa
import rerun as rr
from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder.records import TOPICS, Query, Run, Task
from recorder.records.text import has_line, text_of
from recorder.viewer.marks import LOG, RED, YELLOW, numbered
from recorder.viewer.query_view import QueryView
from recorder.viewer.tables import Tables
from recorder.viewer.task_graph import TaskGraph
from recorder.viewer.timeline import Timeline

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records import Record
    from recorder.viewer.columns import Columns, TimePoint

_COLORS: Final = {"ERROR": [RED], "WARN": [YELLOW]}  # of lines; the viewer's own are of the level alone, and dark
_LEVELS: Final = {Log.DEBUG: "DEBUG", Log.INFO: "INFO", Log.WARNING: "WARN", Log.ERROR: "ERROR"}


class LogView:
    """Log lines, tables, queries and tasks of a recording."""

    def __init__(self, columns: Columns) -> None:
        self._lines = {kind: columns.series(columns.path(LOG, topic[1:]), _lines) for kind, topic in TOPICS.items()}
        self._tables, self._queries = Tables(columns), QueryView(columns)
        self._timeline, self._graph = Timeline(columns), TaskGraph(columns)

    def show(self, record: Record, now: TimePoint) -> None:
        """Shows a record."""
        text, level = text_of(record)
        if has_line(record):
            self._lines[type(record)].add(now, (numbered(text, now), _LEVELS[level]))
        self._tables.show(record, text, now)
        if type(record) is Query:  # isinstance takes five times as long where it is none
            self._queries.show(record, now)
        elif type(record) is Task:
            self._timeline.show(record, now)
            self._graph.show(record, now)
        elif type(record) is Run and record.phase == Run.STARTED:
            self._graph.plan = record.name


def _lines(rows: Sequence[tuple[Any, ...]]) -> list[rr.ComponentColumn]:
    text, levels = zip(*rows, strict=True)
    colors = [_COLORS.get(level, []) for level in levels]
    colored = rr.TextLog.columns(color=[*chain.from_iterable(colors)]).partition([*map(len, colors)])
    return [*rr.TextLog.columns(text=pa.array(text), level=pa.array(levels)), *colored]
