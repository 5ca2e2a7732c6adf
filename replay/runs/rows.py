"""The rows of a recording for the tables of its folder.

The process that made a recording calls :func:`write_rows` at the end; readers make the rows of all other recordings.
Two failures have the same cause if three facts are equal: their types, their first colliding pairs of links, and the
names of the tasks around them. Without links, the first lines of the messages are compared without their numbers, so
failures with other coordinates or seeds have the same cause.
"""

from __future__ import annotations

import json
import os
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from recorder import records
from recorder.records.text import chosen_name, mutation_text, pair_text
from replay.errors import Damaged
from replay.file.record_reader import RecordReader
from replay.history.tasks import INTERRUPT, RootCause, root_cause, uncaught_failure
from replay.runs.schema import COLUMNS, TABLES, VERSION, arrow_schema

FOLDER: Final = "tables"  # name of the subfolder with the tables in a folder of recordings
NEW: Final = "new"  # name of the subfolder with new rows in the folder of tables
_PACKED: Final = pa.ipc.IpcWriteOptions(compression="lz4", use_threads=False)  # other runs need the cores
_NO_TEXTS: Final = pa.array([], pa.string())  # pyarrow imports pandas, which must be imported before a fork
_NO_EVENT: Final = records.Event()  # default for the fields that records of fluents lack
_STATUSES: Final = {
    records.Task.SUCCEEDED: "succeeded",
    records.Task.FAILED: "failed",
    records.Task.CANCELLED: "cancelled",
}
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
    """Return the rows that the process of a recording wrote; None if it wrote no rows, or the recording has changed."""
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
    """Return the rows of a recording by table; raise Damaged if a record is inconsistent, or if none can be read."""
    rows = _Rows()
    for record in log.records():
        try:
            rows.add(record)
        except (ValueError, IndexError) as error:
            raise Damaged(log.path, f"step {record.seq}", str(error)) from error
    if rows.first is None or rows.last is None:
        raise Damaged(log.path, "every record", log.problems or "there is none")
    rows.finish(log, rows.first, rows.last)
    tables = {}
    for table in TABLES:
        schema = arrow_schema(table)
        columns = zip(rows.columns(table.name), schema, strict=True)
        tables[table.name] = pa.table([pa.array(values, column.type) for values, column in columns], schema)
    return tables


class _Rows:
    def __init__(self) -> None:
        self._of: dict[str, list[dict[str, Any]]] = {table.name: [] for table in TABLES}
        #: Columns of the tables of which a record may add many rows.
        self._many: dict[str, list[list[Any]]] = {name: [[] for _ in COLUMNS[name]] for name in ("joints", "poses")}
        self.first: records.Record | None = None
        self.last: records.Record | None = None
        self.start: records.Run | None = None
        self.end: records.Run | None = None
        self._paths: dict[int, str] = defaultdict(str)
        self._tasks: dict[int, dict[str, Any]] = {}  # rows of tasks, by id
        self._violated: set[str] = set()
        self._failing: set[int] = set()  # ids of tasks in which a part failed

    def add(self, record: records.Record) -> None:
        if self.first is None:
            self.first = record
        self.last = record
        if isinstance(record, records.Task):
            self._task(record)
        elif isinstance(record, records.Mutation):
            self._mutation(record)
        elif isinstance(record, records.Query):
            self._query(record)
        elif isinstance(record, records.Event | records.Fluent):
            event = record if isinstance(record, records.Event) else _NO_EVENT
            self._append(
                "events",
                record,
                kind="fluent" if isinstance(record, records.Fluent) else "event",
                name=record.name,
                label=label(record.name, event.arguments),
                sender=event.sender,
                arguments=json_of(event.arguments),
                value=record.after_json if isinstance(record, records.Fluent) else "",
                handlers=len(event.handlers),
            )
        elif isinstance(record, records.Keyframe):
            for state in record.bodies:
                self._state(record.seq, record.world, record.sim_step, state)
        elif isinstance(record, records.Refusal):
            self._failure(record, "refusal", record.failure)
        elif isinstance(record, records.Run | records.Check):
            self._run(record) if isinstance(record, records.Run) else self._check(record)

    def columns(self, table: str) -> Sequence[Sequence[Any]]:
        return self._many.get(table) or [[row[name] for row in self._of[table]] for name in COLUMNS[table]]

    def _append(self, table: str, record: records.Record, **values: Any) -> dict[str, Any]:
        """Add a row about a record. ``values`` are further columns; they replace columns that most tables have."""
        row = {
            "step": record.seq,
            "task": record.task,
            "path": self._paths[record.task],
            "world": record.world,
            "seconds": self._seconds(record),
            "sim_seconds": record.sim_step / records.STEPS_PER_SECOND,
            "source": source(record),
            **values,
        }
        self._of[table].append(row)
        return row

    def _seconds(self, record: records.Record) -> float:
        first = self.first
        if first is None or record.monotonic_ns:
            return record.monotonic_ns / 1e9
        return (record.wall_time_ns - first.wall_time_ns) / 1e9  # early recordings lack the steady clock

    # --- records -----------------------------------------------------------------------------------------------------

    def _run(self, record: records.Run) -> None:
        if record.phase == records.Run.STARTED:
            self.start = record
        elif record.phase == records.Run.FINISHED:
            self.end = record
        if record.HasField("failure"):
            self._failure(record, "thread" if record.phase == records.Run.THREAD_FAILED else "run", record.failure)

    def _task(self, record: records.Task) -> None:
        if record.phase in (records.Task.STARTED, records.Task.ASKED):
            self._begin(record)
            return
        if record.task not in self._tasks:  # the recording doesn't contain the beginning of the task
            self._begin(record)
        if record.phase == records.Task.LEFT:
            return
        row = self._tasks[record.task]
        row["status"] = _STATUSES.get(record.status, "")
        row["last_step"] = record.seq
        row["seconds"] = record.duration_ns / 1e9
        row["sim_took"] = record.sim_step / records.STEPS_PER_SECOND - row["sim_seconds"]
        row["result"] = record.result_json
        if record.solution:
            row["solution"] = json_of(record.solution)
        if record.HasField("decision"):
            row["resolver"], row["module"] = record.decision.resolver, record.decision.module
        if record.HasField("failure"):
            row["failure"], row["message"] = record.failure.type, record.failure.message
        if record.status == records.Task.FAILED:
            row["origin"] = record.task not in self._failing
            self._failing.add(row["parent"])
            if row["origin"]:
                self._failure(record, "task", record.failure)

    def _begin(self, record: records.Task) -> None:
        """Add the row of a task. When a requested task starts, only the time in its row changes."""
        known = self._tasks.get(record.task)
        if known is not None:
            known |= {"began": self._seconds(record), "sim_seconds": record.sim_step / records.STEPS_PER_SECOND}
            return
        outer = self._paths[record.parent]
        path = f"{outer}/{record.name}" if outer else record.name
        self._paths[record.task] = path if len(path) <= _MAX_PATH else outer
        self._tasks[record.task] = self._append(
            "tasks",
            record,
            parent=record.parent,
            kind=record.kind,
            name=record.name,
            label=label(record.name, record.parameters),
            status="running",
            last_step=None,
            began=self._seconds(record),
            seconds=None,
            sim_took=None,
            attempt=record.attempt,
            parameters=json_of(record.parameters),
            solution=json_of(record.solution),
            result="",
            resolver=record.decision.resolver,
            module=record.decision.module,
            origin=False,
            failure="",
            message="",
        )

    def _query(self, record: records.Query) -> None:
        called = label(record.name, record.arguments)
        chosen = record.chosen if record.HasField("chosen") else -1
        self._append(
            "queries",
            record,
            name=record.name,
            label=called,
            arguments=json_of(record.arguments),
            answer=record.answer_json,
            chosen=chosen_name(record),
            candidates=sum(candidate.count or 1 for candidate in record.candidates),
            began=self._seconds(record),
            seconds=record.duration_ns / 1e9,
            failure=record.failure.type,
        )
        for number, candidate in enumerate(record.candidates):
            self._append(
                "choices",
                record,
                query=record.name,
                label=called,
                candidate=", ".join(candidate.names),
                count=candidate.count or 1,
                chosen=number == chosen,
                reason=candidate.reason,
                details=json_of(candidate.data),
            )
        if record.HasField("failure"):
            self._failure(record, "query", record.failure)

    def _mutation(self, record: records.Mutation) -> None:
        command = record.WhichOneof("command") or ""
        self._append(
            "mutations",
            record,
            command=command,
            body=getattr(getattr(record, command, None), "body", ""),
            text=mutation_text(record),
            changed=len(record.effect.bodies),
        )
        for sample in record.effect.samples:
            for state in sample.bodies:
                self._state(record.seq, record.world, sample.sim_step, state)
        for state in record.effect.bodies:
            self._state(record.seq, record.world, record.sim_step, state)

    def _check(self, record: records.Check) -> None:
        violated = record.phase == records.Check.VIOLATED
        self._violated |= {record.property} if violated else set()
        self._append(
            "checks",
            record,
            property=record.property,
            violated=violated,
            at_step=record.step if violated else None,
            margin=record.margin if record.HasField("margin") else None,
            details=json_of(record.values),
            sim_seconds=record.moment / records.STEPS_PER_SECOND,
        )

    def _state(self, step: int, world: str, sim_step: int, state: records.BodyState) -> None:
        same = (step, world, sim_step / records.STEPS_PER_SECOND, state.body)
        if state.position:
            for column, value in zip(self._many["poses"], (*same, *state.position, *state.orientation), strict=True):
                column.append(value)
        if state.joints:
            names, *values = state.joints, state.joint_positions, state.joint_velocities or [0.0] * len(state.joints)
            repeated = ([each] * len(names) for each in same)
            for column, more in zip(self._many["joints"], (*repeated, names, *values), strict=True):
                column.extend(more)

    def _failure(
        self, record: records.Task | records.Query | records.Refusal | records.Run, of: str, failure: records.Failure
    ) -> None:
        self._append(
            "failures",
            record,
            of=of,
            type=failure.type,
            message=failure.message,
            data=json_of(failure.data),
            pairs=pairs_of(failure),
            cause=cause_of(failure, self._paths[record.task]),
            root=False,
        )

    # --- the run -----------------------------------------------------------------------------------------------------

    def finish(self, log: RecordReader, first: records.Record, last: records.Record) -> None:
        """Add the row of the run, after all records."""
        start, end = self.start or records.Run(), self.end
        succeeded = end is not None and end.succeeded
        interrupted = end is not None and end.failure.type == INTERRUPT
        outcome = "succeeded" if succeeded else "cut off" if end is None else "interrupted" if interrupted else "failed"
        broken = root_cause(log) if outcome in ("failed", "cut off") or uncaught_failure(log) is not None else None
        failure, path, step = self._root(broken)
        self._append(
            "runs",
            last,
            plan=start.name or log.metadata.get("plan", ""),
            number=start.sweep.number if start.HasField("sweep") else None,
            parameters=parameters(start),
            arguments=list(start.arguments),
            seed=start.seed,
            branch_order=start.order,
            environment=start.environment,
            outcome=outcome,
            succeeded=None if outcome == "interrupted" else succeeded,
            cause=cause_of(failure, path) if failure is not None else "" if succeeded else outcome,
            failure=failure.type if failure is not None else "",
            message=failure.message if failure is not None else "",
            cause_path=path,
            cause_step=step,
            violated=len(self._violated),
            last_step=log.final_step(),
            began=first.wall_time_ns // 1000,
            seconds=self._seconds(last) - self._seconds(first),
            sim_seconds=max((row["sim_seconds"] for row in self._of["mutations"]), default=0.0),
            records=len(log),
            bytes=log.path.stat().st_size,
            plan_sha256=start.plan.sha256,
            complete=log.complete,
            release=log.metadata.get("pycram", ""),
            host=start.host,
        )

    def _root(self, broken: RootCause | None) -> tuple[records.Failure | None, str, int | None]:
        """Mark the failure that explains the end of the run. Return the failure, the path of its task, and its step."""
        if broken is None:
            return None, "", None
        failure, path = broken.failure, ""
        if broken.task is not None:
            path = broken.task.path
            failure = broken.task.failure or failure
        for row in self._of["failures"]:
            row["root"] = row["step"] == broken.step or (broken.task is None and row["of"] in ("run", "thread"))
        return failure, path, broken.step


def parameters(start: records.Run) -> list[tuple[str, str]]:
    """Return the parameters of a run; if the run has no parameters, the options among its arguments."""
    return list(({each.name: each.value_json for each in start.parameters} or _options(start.arguments)).items())


def _options(arguments: Sequence[str]) -> Mapping[str, str]:
    """Return the JSON values of options such as ``--arm left`` or ``--arm=left``."""
    found: dict[str, str] = {}
    for at, argument in enumerate(arguments):
        option = _OPTION.fullmatch(argument)
        if option is None:
            continue
        following = arguments[at + 1] if at + 1 < len(arguments) else "--"
        value = option[2] if option[2] is not None else None if following.startswith("--") else following
        found[option[1]] = "true" if value is None else records.to_json(records.from_json(value))
    return found


def json_of(arguments: Sequence[records.Argument]) -> str:
    """Return named values as a JSON object; "" if there are none."""
    if not arguments:
        return ""
    return "{" + ",".join([f"{json.dumps(each.name)}:{each.json or 'null'}" for each in arguments]) + "}"


def label(name: str, arguments: Sequence[records.Argument]) -> str:
    """Return a name with the objects among the arguments; without objects, with the type of object."""
    found: dict[str, None] = {}
    for argument in arguments:
        if '{"object":' in argument.json:
            found |= dict.fromkeys(_OBJECT.findall(argument.json))
    if not found:
        named = next((each.json for each in arguments if each.name == "object" and each.json.startswith('"')), "")
        found = {named[1:-1]: None} if named else {}
    return f"{name}({', '.join(list(found)[:_MAX_NAMED])})" if found else name


def source(record: records.Record) -> str:
    """Return the plan's line that caused a record, as ``file:line``; "" if unknown."""
    if isinstance(record, records.Run | records.Keyframe | records.Envelope) or not record.source_file:
        return ""
    return f"{record.source_file}:{record.source_line}"


def without_numbers(text: str) -> str:
    """Return the first line of a text; # replaces each number and each list of numbers."""
    return _LIST.sub("#", _NUMBER.sub("#", text.strip().partition("\n")[0]))


def pairs_of(failure: records.Failure) -> list[str]:
    """Return the text of colliding pairs of links."""
    recorded = records.argument_values(failure.data).get("pairs") if failure.data else None
    return [pair_text(pair) for pair in recorded if isinstance(pair, dict)] if isinstance(recorded, list) else []


def cause_of(failure: records.Failure, path: str) -> str:
    """Return the cause of a failure. ``path`` contains the names of the tasks around the failure."""
    pairs = pairs_of(failure)
    what = pairs[0] if pairs else without_numbers(failure.message)
    where = f" at {without_numbers(path)}" if path else ""
    return f"{failure.type}{where}{f': {what}' if what else ''}"
