"""From records to rows: one pass over a recording, and for a run that failed its root cause."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa

from recorder.records import STEPS_PER_SECOND, Event, Fluent, Keyframe, Mutation, Query, Refusal, Run, Task
from recorder.records.text import chosen_name, mutation_text
from replay.errors import Damaged
from replay.history.failures import INTERRUPT, root_cause, uncaught_failure
from replay.runs.cells import json_of, label, parameters, source
from replay.runs.failure_causes import cause_of, pairs_of
from replay.runs.schema import COLUMNS, TABLES, arrow_schema

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records import BodyState, Failure, Record
    from replay.file.record_reader import RecordReader
    from replay.history.failures import RootCause

_NO_TEXTS: Final = pa.array([], pa.string())  # here pyarrow imports pandas where that is: once, before a process forks
_NO_EVENT: Final = Event()  # a fluent has nothing of what events have
_MAX_PATH: Final = 500  # characters: tasks may be nested a thousand deep
_STATUSES: Final = {Task.SUCCEEDED: "succeeded", Task.FAILED: "failed", Task.CANCELLED: "cancelled"}


def tables_of(log: RecordReader) -> dict[str, pa.Table]:
    """Return the rows of a recording, by the names of the tables.

    Raises:
        Damaged: no record of it can be read, or one makes no sense.
    """
    rows = _Rows()
    for record in log.records():
        try:
            rows.add(record)
        except (ValueError, IndexError) as error:
            raise Damaged(log.path, f"step {record.seq}", str(error)) from error
    if rows.first is None:
        raise Damaged(log.path, "every record", log.problems or "there is none")
    rows.finish(log)
    return {table.name: _table(arrow_schema(table), rows.columns(table.name)) for table in TABLES}


def _table(schema: pa.Schema, columns: Sequence[Sequence[Any]]) -> pa.Table:
    return pa.table([pa.array(values, column.type) for values, column in zip(columns, schema, strict=True)], schema)


class _Rows:
    """The rows of all tables, while records are added."""

    def __init__(self) -> None:
        self._of: dict[str, list[list[Any]]] = {table.name: [] for table in TABLES}
        self._joints: list[list[Any]] = [[] for _ in COLUMNS["joints"]]  # its columns, as rows come by the dozen
        self.first: Record | None = None
        self.last: Record | None = None
        self.start: Run | None = None
        self.end: Run | None = None
        self._paths: dict[int, str] = defaultdict(str)
        self._tasks: dict[int, list[Any]] = {}  # their rows
        self._failing: set[int] = set()  # tasks of which a part failed

    def add(self, record: Record) -> None:
        """Add what a record has."""
        if self.first is None:
            self.first = record
        self.last = record
        if isinstance(record, Task):
            self._task(record)
        elif isinstance(record, Mutation):
            self._mutation(record)
        elif isinstance(record, Query):
            self._query(record)
        elif isinstance(record, Event | Fluent):
            self._event(record)
        elif isinstance(record, Keyframe):
            for state in record.bodies:
                self._state(record.seq, record.world, record.sim_step, state)
        elif isinstance(record, Refusal):
            self._failure(record, "refusal", record.failure)
        elif isinstance(record, Run):
            self._run(record)

    def columns(self, table: str) -> Sequence[Sequence[Any]]:
        """Return the columns of a table."""
        if table == "joints":
            return self._joints
        rows = self._of[table]
        return [*zip(*rows, strict=True)] if rows else [()] * len(COLUMNS[table])

    def _append(self, table: str, *values: Any) -> None:
        self._of[table].append([*values])

    def _seconds(self, record: Record) -> float:
        first = self.first
        if first is None or record.monotonic_ns:
            return record.monotonic_ns / 1e9
        return (record.wall_time_ns - first.wall_time_ns) / 1e9  # early recordings

    # --- records -----------------------------------------------------------------------------------------------------

    def _run(self, record: Run) -> None:
        if record.phase == Run.STARTED:
            self.start = record
        elif record.phase == Run.FINISHED:
            self.end = record
        if record.HasField("failure"):
            self._failure(record, "thread" if record.phase == Run.THREAD_FAILED else "run", record.failure)

    def _task(self, record: Task) -> None:
        if record.phase in (Task.STARTED, Task.ASKED):
            self._begin(record)
            return
        if record.task not in self._tasks:  # its beginning is lost
            self._begin(record)
        if record.phase == Task.LEFT:
            return
        row, at = self._tasks[record.task], COLUMNS["tasks"]
        row[at["status"]] = _STATUSES.get(record.status, "")
        row[at["last_step"]] = record.seq
        row[at["seconds"]] = record.duration_ns / 1e9
        row[at["sim_took"]] = record.sim_step / STEPS_PER_SECOND - row[at["sim_seconds"]]
        row[at["result"]] = record.result_json
        if record.solution:
            row[at["solution"]] = json_of(record.solution)
        if record.HasField("decision"):
            row[at["resolver"]], row[at["module"]] = record.decision.resolver, record.decision.module
        if record.HasField("failure"):
            row[at["failure"]], row[at["message"]] = record.failure.type, record.failure.message
        if record.status == Task.FAILED:
            row[at["origin"]] = record.task not in self._failing
            self._failing.add(row[at["parent"]])
            if row[at["origin"]]:
                self._failure(record, "task", record.failure)

    def _begin(self, record: Task) -> None:
        """Add a task's row; one that was asked for first and starts now gets its start's time."""
        known = self._tasks.get(record.task)
        if known is not None:
            at = COLUMNS["tasks"]
            known[at["began"]] = self._seconds(record)
            known[at["sim_seconds"]] = record.sim_step / STEPS_PER_SECOND
            return
        outer = self._paths[record.parent]
        path = f"{outer}/{record.name}" if outer else record.name
        self._paths[record.task] = path = path if len(path) <= _MAX_PATH else outer
        self._append(
            "tasks",
            record.seq,
            record.task,
            record.parent,
            path,
            record.kind,
            record.name,
            label(record.name, record.parameters),
            record.world,
            "running",
            None,
            self._seconds(record),
            None,
            record.sim_step / STEPS_PER_SECOND,
            None,
            record.attempt,
            json_of(record.parameters),
            json_of(record.solution),
            "",
            record.decision.resolver,
            record.decision.module,
            False,
            "",
            "",
            source(record),
        )
        self._tasks[record.task] = self._of["tasks"][-1]

    def _query(self, record: Query) -> None:
        path = self._paths[record.task]
        called = label(record.name, record.arguments)
        chosen = record.chosen if record.HasField("chosen") else -1
        self._append(
            "queries",
            record.seq,
            record.task,
            path,
            record.name,
            called,
            record.world,
            json_of(record.arguments),
            record.answer_json,
            chosen_name(record),
            sum(candidate.count or 1 for candidate in record.candidates),
            self._seconds(record),
            record.duration_ns / 1e9,
            record.sim_step / STEPS_PER_SECOND,
            record.failure.type,
            source(record),
        )
        for number, candidate in enumerate(record.candidates):
            self._append(
                "choices",
                record.seq,
                record.task,
                path,
                record.name,
                called,
                ", ".join(candidate.names),
                candidate.count or 1,
                number == chosen,
                candidate.reason,
                json_of(candidate.data),
            )
        if record.HasField("failure"):
            self._failure(record, "query", record.failure)

    def _mutation(self, record: Mutation) -> None:
        command = record.WhichOneof("command") or ""
        self._append(
            "mutations",
            record.seq,
            record.task,
            self._paths[record.task],
            record.world,
            command,
            getattr(getattr(record, command, None), "body", ""),
            mutation_text(record),
            len(record.effect.bodies),
            self._seconds(record),
            record.sim_step / STEPS_PER_SECOND,
            source(record),
        )
        for sample in record.effect.samples:
            for state in sample.bodies:
                self._state(record.seq, record.world, sample.sim_step, state)
        for state in record.effect.bodies:
            self._state(record.seq, record.world, record.sim_step, state)

    def _event(self, record: Event | Fluent) -> None:
        event = record if isinstance(record, Event) else _NO_EVENT
        self._append(
            "events",
            record.seq,
            record.task,
            self._paths[record.task],
            "fluent" if isinstance(record, Fluent) else "event",
            record.name,
            label(record.name, event.arguments),
            record.world,
            event.sender,
            json_of(event.arguments),
            record.after_json if isinstance(record, Fluent) else "",
            len(event.handlers),
            self._seconds(record),
            record.sim_step / STEPS_PER_SECOND,
            source(record),
        )

    def _state(self, step: int, world: str, sim_step: int, state: BodyState) -> None:
        """Add where a body and its joints are, as far as they are on record."""
        seconds = sim_step / STEPS_PER_SECOND
        if state.position:
            self._append("poses", step, world, seconds, state.body, *state.position, *state.orientation)
        count = len(state.joints)
        if count:
            velocities = state.joint_velocities or [0.0] * count
            same = ([each] * count for each in (step, world, seconds, state.body))
            for column, values in zip(
                self._joints, (*same, state.joints, state.joint_positions, velocities), strict=True
            ):
                column.extend(values)

    def _failure(self, record: Task | Query | Refusal | Run, of: str, failure: Failure) -> None:
        path = self._paths[record.task]
        self._append(
            "failures",
            record.seq,
            record.task,
            path,
            of,
            failure.type,
            failure.message,
            json_of(failure.data),
            pairs_of(failure),
            cause_of(failure, path),
            False,
            self._seconds(record),
            record.sim_step / STEPS_PER_SECOND,
            "" if isinstance(record, Run) else source(record),
        )

    # --- the run -----------------------------------------------------------------------------------------------------

    def finish(self, log: RecordReader) -> None:
        """Add the run, which is known when all records are."""
        first, last, end = self.first, self.last, self.end
        if first is None or last is None:
            return
        start = self.start or Run()
        outcome, succeeded = "cut off", False
        if end is not None:
            interrupted = end.failure.type == INTERRUPT
            outcome = "succeeded" if end.succeeded else "interrupted" if interrupted else "failed"
            succeeded = end.succeeded
        broken = root_cause(log) if outcome in ("failed", "cut off") or uncaught_failure(log) is not None else None
        failure, path, step = self._root(broken)
        cause = cause_of(failure, path) if failure is not None else "" if succeeded else outcome
        self._append(
            "runs",
            start.name or log.metadata.get("plan", ""),
            start.sweep.number if start.HasField("sweep") else None,
            parameters(start),
            list(start.arguments),
            start.seed,
            start.order,
            start.environment,
            outcome,
            None if outcome == "interrupted" else succeeded,
            cause,
            failure.type if failure is not None else "",
            failure.message if failure is not None else "",
            path,
            step,
            log.final_step(),
            first.wall_time_ns // 1000,
            self._seconds(last) - self._seconds(first),
            max((row[COLUMNS["mutations"]["sim_seconds"]] for row in self._of["mutations"]), default=0.0),
            len(log),
            log.path.stat().st_size,
            start.plan.sha256,
            log.complete,
            log.metadata.get("pycram", ""),
            start.host,
        )

    def _root(self, broken: RootCause | None) -> tuple[Failure | None, str, int | None]:
        """Return the failure that explains the run's end, the path of its task, and its step; mark it."""
        if broken is None:
            return None, "", None
        failure, path = broken.failure, ""
        if broken.task is not None:
            path = broken.task.path
            if broken.task.failure is not None:
                failure = broken.task.failure
        at = COLUMNS["failures"]
        for row in self._of["failures"]:
            of_end = broken.task is None and row[at["of"]] in ("run", "thread")
            row[at["root"]] = row[at["step"]] == broken.step or of_end
        return failure, path, broken.step
