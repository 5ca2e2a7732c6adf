"""What happened in one line each, for people who look at a recording with other tools (``foxglove.Log`` on /log)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder.records import Event, Keyframe, Mutation, Query, Run, Task

if TYPE_CHECKING:
    from collections.abc import Iterable

    from recorder.records import Argument, Record

_NS: Final = 1_000_000_000
_MS: Final = 1e6


def line_of(record: Record) -> Log | None:
    """The line for a record.

    Args:
        record: any.

    Returns:
        The message; None where there is nothing to say (keyframes).
    """
    if isinstance(record, Keyframe):
        return None
    text, level = text_of(record)
    line = Log(level=level, message=text, name=record.world or "plan")
    line.timestamp.seconds, line.timestamp.nanos = divmod(record.wall_time_ns, _NS)
    return line


def text_of(record: Record) -> tuple[str, Log.Level.ValueType]:  # noqa: PLR0911  one for each type of record
    """The same as plain text, with its level.

    Args:
        record: any.
    """
    if isinstance(record, Run):
        return _run(record)
    if isinstance(record, Task):
        return _task(record)
    if isinstance(record, Mutation):
        return mutation_text(record), Log.DEBUG
    if isinstance(record, Event):
        return f"event {record.name}({_values(record.arguments)}), {len(record.handlers)} handlers", Log.INFO
    if isinstance(record, Query):
        if record.HasField("failure"):
            return f"{record.name}({_values(record.arguments)}) raised {record.failure.type}", Log.WARNING
        return f"{record.name}({_values(record.arguments)}) -> {record.answer_json}", Log.INFO
    return f"keyframe of {record.world}", Log.DEBUG


def _run(record: Run) -> tuple[str, Log.Level.ValueType]:
    if record.phase == Run.STARTED:
        return f"{record.name} started", Log.INFO
    if record.succeeded:
        return f"{record.name} succeeded after {record.duration_ns / _NS:.3f} s", Log.INFO
    return f"{record.name} failed: {record.failure.type}: {record.failure.message}", Log.ERROR


def _task(record: Task) -> tuple[str, Log.Level.ValueType]:
    name = f"{record.kind} {record.name}"
    if record.phase == Task.STARTED:
        return f"{name}({_values(record.parameters)})", Log.INFO
    took = f"{record.duration_ns / _MS:.1f} ms"
    if record.status == Task.SUCCEEDED:
        return f"{name} succeeded in {took}", Log.INFO
    if record.status == Task.CANCELLED:
        return f"{name} was cancelled after {took}", Log.WARNING
    return f"{name} failed after {took}: {record.failure.type}: {record.failure.message}", Log.ERROR


def mutation_text(record: Mutation) -> str:
    """What a mutation did, in a few words.

    Args:
        record: the mutation.
    """
    which = record.WhichOneof("command") or "change"
    command = getattr(record, which)
    words = which.replace("_", " ")
    told = []
    for name in ("carrier", "body", "joints", "position", "positions", "steps", "gravity", "enabled", "mode"):
        value = getattr(command, name, None)
        if value is None or value == "" or (which == "load_body" and name == "joints"):
            continue
        if name in ("joints", "positions") and len(value) > 1:
            told.append(f"{len(value)} {name}")
        elif isinstance(value, str | int | bool):
            told.append(str(value))
        elif len(value):
            told.append("[" + ", ".join(item if isinstance(item, str) else f"{item:.3f}" for item in value) + "]")
    moved = [state.body for state in record.effect.bodies]
    along = [name for name in moved if name != getattr(command, "body", "")]
    return f"{words} {' '.join(told)}" + (f", along with {', '.join(along)}" if along and which != "simulate" else "")


def _values(arguments: Iterable[Argument]) -> str:
    return ", ".join(f"{argument.name}={argument.json}" for argument in arguments)
