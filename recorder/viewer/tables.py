"""The typed records as columns of tables, one entity for each type."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa
import rerun as rr

from recorder.log_lines import by_name, values
from recorder.records import TOPICS, Event, Fluent, Mutation, Query, Run, Task

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from recorder.records import Record
    from recorder.viewer.columns import Columns, Moment

RECORDS: Final = "records"


def _task(record: Task) -> tuple[Any, ...]:
    failure = f"{record.failure.type}: {record.failure.message}" if record.HasField("failure") else ""
    status = Task.Status.Name(record.status) if record.status else "RUNNING"
    return (
        record.kind,
        record.name,
        status.lower(),
        record.parent,
        values(record.parameters),
        failure,
        record.duration_ns / 1e6,
        f"{record.source_file}:{record.source_line}" if record.source_file else "",
    )


def _query(record: Query) -> tuple[Any, ...]:
    failure = f"{record.failure.type}: {record.failure.message}" if record.HasField("failure") else ""
    evidence = values(record.evidence)
    answer = by_name(record.answer_json)
    return record.name, values(record.arguments), answer, evidence, failure, record.duration_ns / 1e6


_TELL: Final[Mapping[type[Record], tuple[tuple[str, ...], Callable[[Any], tuple[Any, ...]]]]] = {
    Task: (("kind", "name", "status", "parent", "parameters", "failure", "duration_ms", "source"), _task),
    Mutation: (
        ("command", "bodies"),
        lambda record: (
            str(record.WhichOneof("command") or "change"),
            ", ".join([state.body for state in record.effect.bodies]),
        ),
    ),
    Event: (
        ("name", "sender", "arguments", "handlers"),
        lambda record: (record.name, record.sender, values(record.arguments), len(record.handlers)),
    ),
    Fluent: (
        ("name", "before", "after"),
        lambda record: (record.name, by_name(record.before_json), by_name(record.after_json)),
    ),
    Query: (("name", "arguments", "answer", "evidence", "failure", "duration_ms"), _query),
    Run: (
        ("phase", "name", "succeeded", "failure"),
        lambda record: (
            Run.Phase.Name(record.phase).lower(),
            record.name,
            record.succeeded,
            f"{record.failure.type}: {record.failure.message}" if record.HasField("failure") else "",
        ),
    ),
}


KINDS: Final = tuple(TOPICS[kind].removeprefix("/") for kind in _TELL)
"""Names of the tables."""


class Tables:
    """All records but keyframes, which tell nothing new.

    Args:
        columns: where it goes.
    """

    def __init__(self, columns: Columns) -> None:
        self._series = {
            kind: (
                columns.series(
                    columns.path(RECORDS, TOPICS[kind].removeprefix("/")), partial(_rows, kind.__name__, names)
                ),
                tell,
            )
            for kind, (names, tell) in _TELL.items()
        }

    def show(self, record: Record, text: str, now: Moment) -> None:
        """Shows a record.

        Args:
            record: the record.
            text: what it tells in a line.
            now: when.
        """
        found = self._series.get(type(record))
        if found is not None:
            series, tell = found
            series.add(now, (record.world, record.task, record.thread, text, *tell(record)))


def _rows(kind: str, names: tuple[str, ...], rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    told = zip(
        ("world", "task", "thread", "text", *names),
        (pa.array(column) for column in zip(*rows, strict=True)),
        strict=True,
    )
    return rr.DynamicArchetype.columns(archetype=f"pycram.{kind}", components=dict(told))
