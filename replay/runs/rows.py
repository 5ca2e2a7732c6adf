"""From a recording to rows: one pass over its records, and for a run that failed its root cause.

The process that made a recording calls :func:`write_rows`; readers make the rows of all others. They lie in one file,
the tables one after the other, until readers merge them into the folder's tables (:mod:`replay.runs.folder`).
"""

from __future__ import annotations

import json
import os
import re
from collections import defaultdict
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa

from recorder.records import (
    STEPS_PER_SECOND,
    Event,
    Fluent,
    Keyframe,
    Mutation,
    Query,
    Refusal,
    Run,
    Task,
    from_json,
    to_json,
)
from recorder.records.choices import chosen_name
from recorder.records.text import mutation_text
from replay.errors import Damaged
from replay.explain.root_cause import INTERRUPT, root_cause, uncaught_failure
from replay.file.record_reader import RecordReader
from replay.runs.failure_causes import cause_of, pairs_of
from replay.runs.schema import TABLES, VERSION, arrow_schema

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from recorder.records import Argument, BodyState, Failure, Record
    from replay.explain.root_cause import RootCause

FOLDER: Final = "tables"
"""Where the tables of a folder of recordings lie, beside the recordings."""
NEW: Final = "new"
"""Where the rows of recordings lie in it until they are merged."""

_NO_TEXTS: Final = pa.array([], pa.string())  # here pyarrow imports pandas where that is: once, before a process forks
_OBJECT: Final = re.compile(r'\{"object":"((?:[^"\\]|\\.)*)","world":"(?:[^"\\]|\\.)*"\}')
_OPTION: Final = re.compile(r"--([A-Za-z][\w-]*)(?:=(.*))?", re.DOTALL)
_MAX_NAMED: Final = 3  # objects in a label
_MAX_PATH: Final = 500  # characters: tasks may be nested a thousand deep
_STATUSES: Final = {Task.SUCCEEDED: "succeeded", Task.FAILED: "failed", Task.CANCELLED: "cancelled"}


def write_rows(path: Path) -> None:
    """Write the rows of a recording that has its name and is whole, for readers of its folder.

    Raises:
        ReplayError: it can't be read.
        OSError: the rows can't be written.
    """
    with RecordReader(path) as log:
        tables = tables_of(log)
        state = path.stat()
    folder = path.parent / FOLDER / NEW
    folder.mkdir(parents=True, exist_ok=True)
    partial = folder / f".{path.name}.{os.getpid()}"
    try:
        with partial.open("wb") as file:
            for name, table in tables.items():
                told = {"table": name, "version": str(VERSION), "file": _identity(state)}
                marked = table.replace_schema_metadata(told)
                with pa.ipc.new_stream(file, marked.schema) as stream:
                    stream.write_table(marked)
        partial.replace(folder / f"{path.name}.arrows")
    finally:
        partial.unlink(missing_ok=True)


def read_rows(path: Path, state: os.stat_result) -> dict[str, pa.Table] | None:
    """Return the rows that the process of a recording wrote; None if there are none, or not of the file as it is.

    Args:
        path: the recording.
        state: what the system says of its file.
    """
    tables = {}
    with suppress(OSError, pa.ArrowInvalid), written_rows(path).open("rb") as file:
        for table in TABLES:
            with pa.ipc.open_stream(file) as stream:
                rows = stream.read_all()
            told = {key.decode(): value.decode() for key, value in (rows.schema.metadata or {}).items()}
            if told != {"table": table.name, "version": str(VERSION), "file": _identity(state)}:
                return None
            if not rows.schema.equals(arrow_schema(table)):
                return None
            tables[table.name] = rows.replace_schema_metadata(None)
    return tables if len(tables) == len(TABLES) else None


def written_rows(path: Path) -> Path:
    """Return where the rows of a recording lie that its own process wrote."""
    return path.parent / FOLDER / NEW / f"{path.name}.arrows"


def _identity(state: os.stat_result) -> str:
    return f"{state.st_size} {state.st_mtime_ns}"


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
    return {
        table.name: pa.table(
            [pa.array(rows.columns[table.name][name], kind.type) for name, kind in _named(arrow_schema(table))],
            schema=arrow_schema(table),
        )
        for table in TABLES
    }


def _named(schema: pa.Schema) -> Iterable[tuple[str, pa.Field]]:
    return ((field.name, field) for field in schema)


class _Rows:
    """The columns of all tables, while records are added."""

    def __init__(self) -> None:
        self.columns: dict[str, dict[str, list[Any]]] = {
            table.name: {name: [] for name in table.names} for table in TABLES
        }
        self.first: Record | None = None
        self.last: Record | None = None
        self.start: Run | None = None
        self.end: Run | None = None
        self._paths: dict[int, str] = defaultdict(str)
        self._rows: dict[int, int] = {}  # of the tasks that run: index in their table
        self._parents: dict[int, int] = {}
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

    def _append(self, table: str, *values: Any) -> None:
        for column, value in zip(self.columns[table].values(), values, strict=True):
            column.append(value)

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
        if record.task not in self._rows:  # its beginning is lost
            self._begin(record)
        columns, row = self.columns["tasks"], self._rows[record.task]
        if record.phase == Task.LEFT:
            return
        columns["status"][row] = _STATUSES.get(record.status, "")
        columns["last_step"][row] = record.seq
        columns["seconds"][row] = record.duration_ns / 1e9
        columns["sim_took"][row] = record.sim_step / STEPS_PER_SECOND - columns["sim_seconds"][row]
        columns["result"][row] = record.result_json
        if record.solution:
            columns["solution"][row] = _json_of(record.solution)
        if record.HasField("decision"):
            columns["resolver"][row], columns["module"][row] = record.decision.resolver, record.decision.module
        if record.HasField("failure"):
            columns["failure"][row], columns["message"][row] = record.failure.type, record.failure.message
        if record.status == Task.FAILED:
            columns["origin"][row] = record.task not in self._failing
            self._failing.add(self._parents[record.task])
            if columns["origin"][row]:
                self._failure(record, "task", record.failure)

    def _begin(self, record: Task) -> None:
        """Add a task's row; one that was asked for first and starts now gets its start's time."""
        known = self._rows.get(record.task)
        if known is not None:
            self.columns["tasks"]["began"][known] = self._seconds(record)
            self.columns["tasks"]["sim_seconds"][known] = record.sim_step / STEPS_PER_SECOND
            return
        outer = self._paths[record.parent]
        path = f"{outer}/{record.name}" if outer else record.name
        self._paths[record.task] = path = path if len(path) <= _MAX_PATH else outer
        self._rows[record.task] = len(self.columns["tasks"]["step"])
        self._parents[record.task] = record.parent
        self._append(
            "tasks",
            record.seq,
            record.task,
            record.parent,
            path,
            record.kind,
            record.name,
            _label(record.name, record.parameters),
            record.world,
            "running",
            None,
            self._seconds(record),
            None,
            record.sim_step / STEPS_PER_SECOND,
            None,
            record.attempt,
            _json_of(record.parameters),
            _json_of(record.solution),
            "",
            record.decision.resolver,
            record.decision.module,
            False,
            "",
            "",
            _source(record),
        )

    def _query(self, record: Query) -> None:
        path = self._paths[record.task]
        label = _label(record.name, record.arguments)
        chosen = record.chosen if record.HasField("chosen") else -1
        self._append(
            "queries",
            record.seq,
            record.task,
            path,
            record.name,
            label,
            record.world,
            _json_of(record.arguments),
            record.answer_json,
            chosen_name(record),
            sum(candidate.count or 1 for candidate in record.candidates),
            self._seconds(record),
            record.duration_ns / 1e9,
            record.sim_step / STEPS_PER_SECOND,
            record.failure.type,
            _source(record),
        )
        for number, candidate in enumerate(record.candidates):
            self._append(
                "choices",
                record.seq,
                record.task,
                path,
                record.name,
                label,
                ", ".join(candidate.names),
                candidate.count or 1,
                number == chosen,
                candidate.reason,
                _json_of(candidate.data),
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
            _source(record),
        )
        for sample in record.effect.samples:
            for state in sample.bodies:
                self._state(record.seq, record.world, sample.sim_step, state)
        for state in record.effect.bodies:
            self._state(record.seq, record.world, record.sim_step, state)

    def _event(self, record: Event | Fluent) -> None:
        event = record if isinstance(record, Event) else Event()
        self._append(
            "events",
            record.seq,
            record.task,
            self._paths[record.task],
            "fluent" if isinstance(record, Fluent) else "event",
            record.name,
            _label(record.name, event.arguments),
            record.world,
            event.sender,
            _json_of(event.arguments),
            record.after_json if isinstance(record, Fluent) else "",
            len(event.handlers),
            self._seconds(record),
            record.sim_step / STEPS_PER_SECOND,
            _source(record),
        )

    def _state(self, step: int, world: str, sim_step: int, state: BodyState) -> None:
        """Add where a body and its joints are, of those that are told."""
        seconds = sim_step / STEPS_PER_SECOND
        if state.position:
            self._append("poses", step, world, seconds, state.body, *state.position, *state.orientation)
        count = len(state.joints)
        if count:
            columns = self.columns["joints"]
            columns["step"] += [step] * count
            columns["world"] += [world] * count
            columns["sim_seconds"] += [seconds] * count
            columns["body"] += [state.body] * count
            columns["joint"] += state.joints
            columns["position"] += state.joint_positions
            columns["velocity"] += state.joint_velocities or [0.0] * count

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
            _json_of(failure.data),
            pairs_of(failure),
            cause_of(failure, path),
            False,
            self._seconds(record),
            record.sim_step / STEPS_PER_SECOND,
            "" if isinstance(record, Run) else _source(record),
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
            _number(start),
            _parameters(start),
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
            max(self.columns["mutations"]["sim_seconds"], default=0.0),
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
        failures = self.columns["failures"]
        for row, step in enumerate(failures["step"]):
            of_end = broken.task is None and failures["of"][row] in ("run", "thread")
            failures["root"][row] = step == broken.step or of_end
        return failure, path, broken.step


def _number(start: Run) -> int | None:
    """Return which run of its sweep it is."""
    return start.sweep.number if start.HasField("sweep") else None


def _parameters(start: Run) -> list[tuple[str, str]]:
    """Return what a run was given: a sweep's parameters, else options of its arguments."""
    given = {each.name: each.value_json for each in start.parameters}
    return list((given or _options(start.arguments)).items())


def _options(arguments: Sequence[str]) -> Mapping[str, str]:
    """Return the options among arguments, as ``--arm left`` or ``--arm=left``, their values as JSON."""
    found: dict[str, str] = {}
    for at, argument in enumerate(arguments):
        option = _OPTION.fullmatch(argument)
        if option is None:
            continue
        following = arguments[at + 1] if at + 1 < len(arguments) else "--"
        value = option[2] if option[2] is not None else None if following.startswith("--") else following
        found[option[1]] = "true" if value is None else to_json(from_json(value))
    return found


def _json_of(arguments: Sequence[Argument]) -> str:
    """Return named values as one JSON object; "" if there are none."""
    if not arguments:
        return ""
    return "{" + ",".join([f"{json.dumps(each.name)}:{each.json or 'null'}" for each in arguments]) + "}"


def _label(name: str, arguments: Sequence[Argument]) -> str:
    """Return a name with the objects among the values that it was given, else with the type that it looks for."""
    found: dict[str, None] = {}
    for argument in arguments:
        if '{"object":' in argument.json:
            found |= dict.fromkeys(_OBJECT.findall(argument.json))
    if not found:
        named = next((each.json for each in arguments if each.name == "object" and each.json.startswith('"')), "")
        found = {named[1:-1]: None} if named else {}
    return f"{name}({', '.join(list(found)[:_MAX_NAMED])})" if found else name


def _source(record: Task | Query | Mutation | Event | Fluent | Refusal) -> str:
    return f"{record.source_file}:{record.source_line}" if record.source_file else ""
