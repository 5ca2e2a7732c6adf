"""The rows of a recording for the tables of its folder.

The process that made a recording calls :func:`write_rows` at the end; readers make the rows of all other recordings.
Two failures have the same cause if their types, their first colliding pairs of links, and the names of the tasks around
them are equal. Without links, the first line of the message is compared without its numbers, so coordinates and seeds
don't split a cause.
"""

from __future__ import annotations

import json
import os
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from recorder.records import (
    STEPS_PER_SECOND,
    Argument,
    BodyState,
    Check,
    Event,
    Failure,
    Fluent,
    Keyframe,
    Mutation,
    Query,
    Record,
    Refusal,
    Run,
    Task,
    argument_values,
    from_json,
    to_json,
)
from recorder.records.text import chosen_name, mutation_text, pair_text
from replay.errors import Damaged
from replay.file.record_reader import RecordReader
from replay.history.tasks import INTERRUPT, RootCause, root_cause, uncaught_failure
from replay.runs.schema import COLUMNS, TABLES, VERSION, arrow_schema

FOLDER: Final = "tables"  # name of the subfolder with the tables in a folder of recordings
NEW: Final = "new"  # name of the subfolder with new rows in the folder of tables
_PACKED: Final = pa.ipc.IpcWriteOptions(compression="lz4", use_threads=False)  # other runs need the cores
_NO_TEXTS: Final = pa.array([], pa.string())  # pyarrow imports pandas, which must be imported before a fork
_NO_EVENT: Final = Event()  # default for the fields that records of fluents lack
_STATUSES: Final = {Task.SUCCEEDED: "succeeded", Task.FAILED: "failed", Task.CANCELLED: "cancelled"}
_OBJECT: Final = re.compile(r'\{"object":"((?:[^"\\]|\\.)*)","world":"(?:[^"\\]|\\.)*"\}')
_OPTION: Final = re.compile(r"--([A-Za-z][\w-]*)(?:=(.*))?", re.DOTALL)
_NUMBER: Final = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")
_LIST: Final = re.compile(r"[\[(]#(?:, #)*[\])]")
_MAX_PATH: Final = 500  # maximum number of characters of a path, because tasks may be nested a thousand levels deep
_MAX_NAMED: Final = 3  # maximum number of objects in a label


def write_rows(path: Path) -> None:
    """Write the rows of a finished recording, for readers of its folder.

    Raises:
        ReplayError: The recording can't be read.
        OSError: The rows can't be written.
    """
    with RecordReader(path) as log:
        tables = tables_of(log)
        state = path.stat()
    rows, partial = written_rows(path), partial_rows(path)
    rows.parent.mkdir(parents=True, exist_ok=True)
    try:
        with partial.open("wb") as file:
            for name, table in tables.items():
                marked = table.replace_schema_metadata(_marks(name, state))
                with pa.ipc.new_stream(file, marked.schema, options=_PACKED) as stream:
                    stream.write_table(marked)
        with suppress(FileNotFoundError):  # a reader has already removed the file
            partial.replace(rows)
    finally:
        partial.unlink(missing_ok=True)


def read_rows(path: Path, state: os.stat_result) -> dict[str, pa.Table] | None:
    """Return the rows that the process of a recording wrote; None without rows and for a changed recording."""
    tables = {}
    with suppress(OSError, pa.ArrowInvalid), written_rows(path).open("rb") as file:
        for table in TABLES:
            with pa.ipc.open_stream(file) as stream:
                rows = stream.read_all()
            marks = {key.decode(): value.decode() for key, value in (rows.schema.metadata or {}).items()}
            if marks != _marks(table.name, state) or not rows.schema.equals(arrow_schema(table)):
                return None
            tables[table.name] = rows.replace_schema_metadata(None)
    return tables if len(tables) == len(TABLES) else None


def written_rows(path: Path) -> Path:
    """Return the file of the rows that the process of a recording wrote."""
    return path.parent / FOLDER / NEW / f"{path.name}.arrows"


def partial_rows(path: Path) -> Path:
    """Return the file of incomplete rows, which remains after a killed writer."""
    rows = written_rows(path)
    return rows.with_name(f".{rows.name}")


def _marks(table: str, state: os.stat_result) -> dict[str, str]:
    """Return the metadata of a file of rows: recording, table and version."""
    return {"table": table, "version": str(VERSION), "file": f"{state.st_size} {state.st_mtime_ns}"}


def tables_of(log: RecordReader) -> dict[str, pa.Table]:
    """Return the rows of a recording by the names of the tables.

    Raises:
        Damaged: No record can be read, or a record is inconsistent.
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
    tables = {}
    for table in TABLES:
        schema = arrow_schema(table)
        columns = zip(rows.columns(table.name), schema, strict=True)
        tables[table.name] = pa.table([pa.array(values, column.type) for values, column in columns], schema)
    return tables


class _Rows:
    def __init__(self) -> None:
        self._of: dict[str, list[list[Any]]] = {table.name: [] for table in TABLES}
        self._joints: list[list[Any]] = [[] for _ in COLUMNS["joints"]]  # columns, because a record may add many rows
        self.first: Record | None = None
        self.last: Record | None = None
        self.start: Run | None = None
        self.end: Run | None = None
        self._paths: dict[int, str] = defaultdict(str)
        self._tasks: dict[int, list[Any]] = {}  # rows of tasks, by id
        self._violated: set[str] = set()
        self._failing: set[int] = set()  # ids of tasks in which a part failed

    def add(self, record: Record) -> None:
        """Add the rows of a record."""
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
        elif isinstance(record, Run | Check):
            self._run(record) if isinstance(record, Run) else self._check(record)

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
        return (record.wall_time_ns - first.wall_time_ns) / 1e9  # early recordings lack the steady clock

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
        if record.task not in self._tasks:  # the recording doesn't contain the beginning of the task
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
        """Add the row of a task. When a requested task starts, only the time in its row changes."""
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

    def _check(self, record: Check) -> None:
        violated = record.phase == Check.VIOLATED
        self._violated |= {record.property} if violated else set()
        self._append(
            "checks",
            record.seq,
            record.task,
            self._paths[record.task],
            record.property,
            violated,
            record.step if violated else None,
            record.margin if record.HasField("margin") else None,
            json_of(record.values),
            record.world,
            record.moment / STEPS_PER_SECOND,
            source(record),
        )

    def _state(self, step: int, world: str, sim_step: int, state: BodyState) -> None:
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
        """Add the row of the run, after all records."""
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
            len(self._violated),
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
        """Mark the failure that explains the end of the run. Return the failure, the path of its task, and its step."""
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


def parameters(start: Run) -> list[tuple[str, str]]:
    """Return the parameters of a run; if it has none, the options among its arguments."""
    given = {each.name: each.value_json for each in start.parameters}
    return list((given or _options(start.arguments)).items())


def _options(arguments: Sequence[str]) -> Mapping[str, str]:
    """Return the JSON values of options such as ``--arm left`` or ``--arm=left``."""
    found: dict[str, str] = {}
    for at, argument in enumerate(arguments):
        option = _OPTION.fullmatch(argument)
        if option is None:
            continue
        following = arguments[at + 1] if at + 1 < len(arguments) else "--"
        value = option[2] if option[2] is not None else None if following.startswith("--") else following
        found[option[1]] = "true" if value is None else to_json(from_json(value))
    return found


def json_of(arguments: Sequence[Argument]) -> str:
    """Return named values as a JSON object; "" if there are none."""
    if not arguments:
        return ""
    return "{" + ",".join([f"{_key(each.name)}:{each.json or 'null'}" for each in arguments]) + "}"


@lru_cache(maxsize=10_000)
def _key(name: str) -> str:
    return json.dumps(name)


def label(name: str, arguments: Sequence[Argument]) -> str:
    """Return a name with the objects among the arguments; without objects, with the type of object."""
    found: dict[str, None] = {}
    for argument in arguments:
        if '{"object":' in argument.json:
            found |= dict.fromkeys(_OBJECT.findall(argument.json))
    if not found:
        named = next((each.json for each in arguments if each.name == "object" and each.json.startswith('"')), "")
        found = {named[1:-1]: None} if named else {}
    return f"{name}({', '.join(list(found)[:_MAX_NAMED])})" if found else name


def source(record: Task | Query | Mutation | Event | Fluent | Refusal | Check) -> str:
    """Return the plan's line that caused a record, as ``file:line``; "" if unknown."""
    return f"{record.source_file}:{record.source_line}" if record.source_file else ""


def without_numbers(text: str) -> str:
    """Return the first line of a text; # replaces each number and each list of numbers."""
    return _LIST.sub("#", _NUMBER.sub("#", text.strip().partition("\n")[0]))


def pairs_of(failure: Failure) -> list[str]:
    """Return the text of colliding pairs of links."""
    recorded = argument_values(failure.data).get("pairs") if failure.data else None
    return [pair_text(pair) for pair in recorded if isinstance(pair, dict)] if isinstance(recorded, list) else []


def cause_of(failure: Failure, path: str) -> str:
    """Return the cause of a failure. ``path`` contains the names of the tasks around the failure."""
    pairs = pairs_of(failure)
    what = pairs[0] if pairs else without_numbers(failure.message)
    where = f" at {without_numbers(path)}" if path else ""
    return f"{failure.type}{where}{f': {what}' if what else ''}"
