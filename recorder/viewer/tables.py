"""The typed records as columns of tables, one entity for each type."""

from __future__ import annotations

from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa
import rerun as rr

from recorder.log_lines import by_name, values
from recorder.records import TOPICS, Event, Fluent, Mutation, Query, Run, Task, told_failure

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from google.protobuf.internal.enum_type_wrapper import EnumTypeWrapper

    from recorder.records import Record
    from recorder.viewer.columns import Columns, Moment

RECORDS: Final = "records"


def _failure(record: Task | Query | Run) -> str:
    return told_failure(record.failure) if record.HasField("failure") else ""


def _status(record: Task) -> str:
    return _word(Task.Status, record.status) if record.status else "running"


def _word(words: EnumTypeWrapper, number: int) -> str:
    return words.Name(number).lower() if number in words.values() else str(number)


def _source(record: Task | Mutation) -> str:
    return _line(record.source_file, record.source_line) if record.source_file else ""


def _callers(record: Task | Mutation) -> str:
    return ", ".join([_line(caller.file or record.source_file, caller.line) for caller in record.callers[:]])


def _line(file: str, line: int) -> str:
    """A line by the file's name: columns are narrow."""
    return f"{file.rpartition('/')[2]}:{line}"


_TELL: Final[Mapping[type[Record], Mapping[str, Callable[[Any], object]]]] = {
    Task: {
        "kind": attrgetter("kind"),
        "name": attrgetter("name"),
        "status": _status,
        "parent": attrgetter("parent"),
        "parameters": lambda record: values(record.parameters),
        "failure": _failure,
        "duration_ms": lambda record: record.duration_ns / 1e6,
        "callers": _callers,
    },
    Mutation: {
        "command": lambda record: str(record.WhichOneof("command") or "change"),
        "bodies": lambda record: ", ".join([state.body for state in record.effect.bodies[:]]),
        "callers": _callers,
    },
    Event: {
        "name": attrgetter("name"),
        "sender": attrgetter("sender"),
        "arguments": lambda record: values(record.arguments),
        "handlers": lambda record: len(record.handlers),
    },
    Fluent: {
        "name": attrgetter("name"),
        "before": lambda record: by_name(record.before_json),
        "after": lambda record: by_name(record.after_json),
    },
    Query: {
        "name": attrgetter("name"),
        "arguments": lambda record: values(record.arguments),
        "answer": lambda record: by_name(record.answer_json),
        "evidence": lambda record: values(record.evidence),
        "failure": _failure,
        "duration_ms": lambda record: record.duration_ns / 1e6,
    },
    Run: {
        "phase": lambda record: _word(Run.Phase, record.phase),
        "name": attrgetter("name"),
        "succeeded": attrgetter("succeeded"),
        "failure": _failure,
    },
}
"""Names of columns, and what they tell of a record."""

_SOURCED: Final = (Task, Mutation)
"""Types of records that tell the plan's line which made them: changes only where it isn't their task's."""

KINDS: Final = tuple(TOPICS[kind].removeprefix("/") for kind in _TELL)
"""Names of the tables."""


class Tables:
    """All records but keyframes, which tell nothing new.

    Args:
        columns: where it goes.
    """

    def __init__(self, columns: Columns) -> None:
        self._series = {
            kind: columns.series(columns.path(RECORDS, TOPICS[kind].removeprefix("/")), partial(_rows, kind))
            for kind in _TELL
        }
        self._asked: dict[int, str] = {}  # lines of the plan that asked for the tasks that run

    def show(self, record: Record, text: str, now: Moment) -> None:
        """Shows a record.

        Args:
            record: the record, which nobody changes any more.
            text: what it tells in a line.
            now: when.
        """
        series = self._series.get(type(record))
        if series is not None:
            series.add(now, (record, text, self._source(record)))

    def _source(self, record: Record) -> str:
        """The plan's line that made a record, or asked for the task that did."""
        if not isinstance(record, _SOURCED):
            return ""
        source = _source(record) or self._asked.get(record.task, "")
        if isinstance(record, Task):
            if record.phase == Task.FINISHED:
                self._asked.pop(record.task, None)
            else:
                self._asked[record.task] = source
        return source


def _rows(kind: type[Record], rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    records, texts, sources = zip(*rows, strict=True)
    told = {
        "world": [record.world for record in records],
        "task": [record.task for record in records],
        "thread": [record.thread for record in records],
        "text": texts,
        **{name: [*map(tell, records)] for name, tell in _TELL[kind].items()},
        **({"source": sources} if kind in _SOURCED else {}),
    }
    components = {name: pa.array(column) for name, column in told.items()}
    return rr.DynamicArchetype.columns(archetype=f"pycram.{kind.__name__}", components=components)
