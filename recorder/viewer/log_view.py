"""What is told of a recording: log, tables, queries, and tasks as lanes and as a graph. It needs no scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

from recorder.records import Query, Run, Task
from recorder.records.text import text_of
from recorder.viewer.log_lines import Lines
from recorder.viewer.query_view import Questions
from recorder.viewer.tables import Tables
from recorder.viewer.task_graph import Graph
from recorder.viewer.timeline import Timeline

if TYPE_CHECKING:
    from recorder.records import Record
    from recorder.viewer.columns import Columns, Moment


class LogView:
    """All that is told.

    Args:
        columns: where it goes.
    """

    def __init__(self, columns: Columns) -> None:
        self._lines, self._tables = Lines(columns), Tables(columns)
        self._lanes, self._graph = Timeline(columns), Graph(columns)
        self._questions = Questions(columns)

    def show(self, record: Record, now: Moment) -> None:
        """Shows a record.

        Args:
            record: the next one.
            now: when.
        """
        text, level = text_of(record)
        self._lines.show(record, text, level, now)
        self._tables.show(record, text, now)
        if type(record) is Query:  # isinstance takes five times as long where it is none
            self._questions.show(record, now)
        elif type(record) is Task:
            self._lanes.show(record, now)
            self._graph.show(record, now)
        elif type(record) is Run and record.phase == Run.STARTED:
            self._graph.begin(record)
