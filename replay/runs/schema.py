"""The tables of a folder of recordings: columns and meanings. The documentation is generated from this module.

Values of types that users define are JSON, as in recordings. Times are seconds since the beginning of the recording.
``sim_seconds`` is the simulated time of the record's world.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import pyarrow as pa

VERSION: Final = 2  # version of the tables. Tables of another version are made again from the recordings.


@dataclass(frozen=True, slots=True)
class Column:
    """A column."""

    name: str
    kind: str  # "text", "whole", "number" (both 64 bits), "yes/no", "moment" (UTC), "texts" or "map" (of texts)
    meaning: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table. The first column of each table is ``run``."""

    name: str
    meaning: str  # meaning of a row
    columns: tuple[Column, ...]  # columns without ``run``


RUN: Final = Column("run", "text", "name of the recording's file")


def _table(name: str, meaning: str, *columns: tuple[str, str, str]) -> Table:
    return Table(name, meaning, tuple(Column(*column) for column in columns))


_STEP: Final = ("step", "whole", "step of the record")
_RECORD: Final = (
    _STEP,
    ("task", "whole", "id of the task that made the record; 0: no task"),
    ("path", "text", "names of this task and of the tasks around it, outermost first, in the form `a/b/c`"),
)
_WORLD: Final = ("world", "text", "name of the world")
_SIM: Final = ("sim_seconds", "number", "simulated time in s")
_SOURCE: Final = ("source", "text", "the plan's line, in the form `file:line`")
_WHEN: Final = (("seconds", "number", "time in s since the recording began"), _SIM, _SOURCE)
_ERROR: Final = ("failure", "text", "type of the raised error; empty: no error")

TABLES: Final = (
    _table(
        "runs",
        "a recording",
        ("plan", "text", "name of the plan"),
        ("number", "whole", "number of the run in its sweep; null: the run isn't part of a sweep"),
        ("parameters", "map", "parameters, with values as JSON; without parameters, the options among the arguments"),
        ("arguments", "texts", "arguments of the plan"),
        ("seed", "text", "seed of random numbers and of the order of branches"),
        ("branch_order", "text", "requested order of branches; empty: drawn from the seed"),
        ("environment", "text", "requested execution environment"),
        ("outcome", "text", "`succeeded`, `failed`, `interrupted`, or `cut off` (the run's process was killed)"),
        ("succeeded", "yes/no", "whether the run succeeded; null: the run was interrupted"),
        ("cause", "text", "text of the failure's cause, equal for all runs with this cause; empty: no failure"),
        ("failure", "text", "type of the failure that explains the run's end; empty: no failure"),
        ("message", "text", "message of the failure that explains the run's end"),
        ("cause_path", "text", "names of the tasks in which the failure began"),
        ("cause_step", "whole", "step at which the failure began; null: no failure"),
        ("violated", "whole", "number of properties that were watched and violated"),
        ("last_step", "whole", "the last step at which a world was open"),
        ("began", "moment", "time at which the run began"),
        ("seconds", "number", "duration, s"),
        ("sim_seconds", "number", "simulated time of the run's last change, s"),
        ("records", "whole", "number of records"),
        ("bytes", "whole", "size of the file in bytes"),
        ("plan_sha256", "text", "hash of the plan's text"),
        ("complete", "yes/no", "whether the recording is complete and undamaged"),
        ("release", "text", "release of PyCRAM that made the recording"),
        ("host", "text", "computer"),
    ),
    _table(
        "tasks",
        "a task",
        ("step", "whole", "step at which the task started, or was requested"),
        ("task", "whole", "id of the task"),
        ("parent", "whole", "id of the task around this task; 0: no task"),
        ("path", "text", "names from the outermost task to this task, in the form `a/b/c`"),
        ("kind", "text", "`motion`, `process-module`, `block`, `branch`, `attempt`, ..."),
        ("name", "text", "name of the task"),
        ("label", "text", "name of the task, with the objects among the parameters, such as `pick-up(spoon)`"),
        _WORLD,
        ("status", "text", "`succeeded`, `failed`, `cancelled`, or `running` (the recording lacks the task's end)"),
        ("last_step", "whole", "step at which the task ended; null: the recording lacks the end"),
        ("began", "number", "start in s since the recording began"),
        ("seconds", "number", "duration, s"),
        _SIM,
        ("sim_took", "number", "duration in simulated time, s"),
        ("attempt", "whole", "number of an attempt, from 1; 0 for other tasks"),
        ("parameters", "text", "JSON"),
        ("solution", "text", "the resolved parameters, as JSON"),
        ("result", "text", "JSON"),
        ("resolver", "text", "function that found the solution"),
        ("module", "text", "class of the process module"),
        ("origin", "yes/no", "whether a failure began in this task, and not in a part of the task"),
        _ERROR,
        ("message", "text", "message of the failure"),
        _SOURCE,
    ),
    _table(
        "queries",
        "a reasoning query, or a choice",
        *_RECORD,
        ("name", "text", "name of the query"),
        ("label", "text", "name of the query, with the objects among the arguments, such as `reachable_object(milk)`"),
        _WORLD,
        ("arguments", "text", "JSON"),
        ("answer", "text", "JSON; empty: no answer"),
        ("chosen", "text", "name of the chosen candidate; empty: no chosen candidate"),
        ("candidates", "whole", "number of considered candidates"),
        ("began", "number", "start in s since the recording began"),
        ("seconds", "number", "duration, s"),
        _SIM,
        _ERROR,
        _SOURCE,
    ),
    _table(
        "choices",
        "a candidate of a query, or several candidates that were rejected for the same reason",
        *_RECORD,
        ("query", "text", "name of the query"),
        ("label", "text", "name of the query with its objects"),
        ("candidate", "text", "names of the candidates, such as `front`"),
        ("count", "whole", "number of candidates"),
        ("chosen", "yes/no", "whether the candidate was chosen"),
        ("reason", "text", "type of the reason for the rejection; empty: not rejected"),
        ("details", "text", "data of the reason, as JSON"),
    ),
    _table(
        "mutations",
        "a change of a world",
        *_RECORD,
        _WORLD,
        ("command", "text", "`move_body`, `attach_body`, `simulate`, ..."),
        ("body", "text", "name of the changed object; empty: no object"),
        ("text", "text", "the change in words"),
        ("changed", "whole", "number of bodies that changed"),
        *_WHEN,
    ),
    _table(
        "events",
        "an event, or a fluent's change",
        *_RECORD,
        ("kind", "text", "`event` or `fluent`"),
        ("name", "text", "name of the event or fluent"),
        ("label", "text", "name of the event or fluent, with the objects among the arguments"),
        _WORLD,
        ("sender", "text", "object that fired the event"),
        ("arguments", "text", "arguments of the event, as JSON"),
        ("value", "text", "value of the fluent after the change, as JSON"),
        ("handlers", "whole", "number of called handlers of the event"),
        *_WHEN,
    ),
    _table(
        "checks",
        "a property that was watched in the run, or a violation of a property",
        *_RECORD,
        ("property", "text", "text of the property"),
        ("violated", "yes/no", "whether the row is a violation"),
        ("at_step", "whole", "step at which the property is violated; null: no violation"),
        ("margin", "number", "negative margin in m, rad or s; null: no violation, or no margin"),
        ("details", "text", "values of the property's quantities, as JSON"),
        _WORLD,
        _SIM,
        _SOURCE,
    ),
    _table(
        "failures",
        "a refusal, or a failure of a query, of the run, or of the task in which the failure began",
        *_RECORD,
        ("of", "text", "`task`, `query`, `refusal`, `run` or `thread`"),
        ("type", "text", "type of the error"),
        ("message", "text", "message of the error"),
        ("data", "text", "fields of the error, as JSON"),
        ("pairs", "texts", "links that would have collided, such as `l_gripper_palm_link / counter`"),
        ("cause", "text", "cause of the failure, without numbers"),
        ("root", "yes/no", "whether the failure explains how the run ended"),
        *_WHEN,
    ),
    _table(
        "joints",
        "a position of a joint: after each change, and 30 times per simulated second while it moves",
        _STEP,
        _WORLD,
        _SIM,
        ("body", "text", "name of the object"),
        ("joint", "text", "name of the joint"),
        ("position", "number", "rad or m"),
        ("velocity", "number", "rad/s or m/s"),
    ),
    _table(
        "poses",
        "a pose of a body: after each change, and 30 times per simulated second while it moves",
        _STEP,
        _WORLD,
        _SIM,
        ("body", "text", "name of the object"),
        ("x", "number", "position of the body's base in the world, in m"),
        ("y", "number", "m"),
        ("z", "number", "m"),
        ("qx", "number", "orientation of the body's base, a unit quaternion: x"),
        ("qy", "number", ""),
        ("qz", "number", ""),
        ("qw", "number", ""),
    ),
)

COLUMNS: Final = {table.name: tuple(column.name for column in table.columns) for table in TABLES}
"""Names of the columns of each table, except ``run``."""


@cache
def arrow_schema(table: Table) -> pa.Schema:
    """Return the Arrow schema of a table without ``run``."""
    import pyarrow as pa  # noqa: PLC0415  the documentation works without pyarrow

    kinds = {
        "text": pa.string(),
        "whole": pa.int64(),
        "number": pa.float64(),
        "yes/no": pa.bool_(),
        "moment": pa.timestamp("us", "UTC"),
        "texts": pa.list_(pa.string()),
        "map": pa.map_(pa.string(), pa.string()),
    }
    return pa.schema([(column.name, kinds[column.kind]) for column in table.columns])
