"""What happened in one line each, for people who look at a recording with other tools (``foxglove.Log`` on /log).

Lists of records are copied (``[:]``) to go through them: protobuf's own iterators take three times as long.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder.records import Event, Fluent, Keyframe, Mutation, Query, Run, Task, told_failure

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from recorder.records import Argument, MoveJoints, Record

_NS: Final = 1_000_000_000
_MS: Final = 1e6
_THREE: Final = "[%.3f, %.3f, %.3f]"  # of most values, and faster than what fits any number of them


def line_of(record: Record, time_ns: int) -> Log | None:
    """The line for a record.

    Args:
        record: any.
        time_ns: when it was, in ns since the Unix epoch.

    Returns:
        The message; None where there is nothing to say (keyframes, and tasks that are only asked for).
    """
    kind = type(record)
    if kind is Keyframe or (isinstance(record, Task) and record.phase == Task.ASKED):
        return None
    text, level = text_of(record)
    line = Log(level=level, message=text, name="plan" if kind is Run or kind is Task else record.world or "plan")
    moment = line.timestamp
    moment.seconds, moment.nanos = divmod(time_ns, _NS)
    return line


def text_of(record: Record) -> tuple[str, Log.Level.ValueType]:  # noqa: PLR0911  one for each type of record
    """The same as plain text, with its level.

    Args:
        record: any.
    """
    if isinstance(record, Task):
        return _task(record)
    if isinstance(record, Mutation):
        return mutation_text(record), Log.DEBUG
    if isinstance(record, Event):
        return f"event {record.name}({values(record.arguments)}), {len(record.handlers)} handlers", Log.INFO
    if isinstance(record, Fluent):
        return _fluent(record), Log.DEBUG
    if isinstance(record, Query):
        if record.HasField("failure"):
            return f"{record.name}({values(record.arguments)}) raised {record.failure.type}", Log.WARNING
        return f"{record.name}({values(record.arguments)}) -> {by_name(record.answer_json)}", Log.INFO
    if isinstance(record, Run):
        return _run(record)
    return f"keyframe of {record.world}", Log.DEBUG


def _run(record: Run) -> tuple[str, Log.Level.ValueType]:
    if record.phase == Run.STARTED:
        return f"{record.name} started", Log.INFO
    if record.phase == Run.THREAD_FAILED:
        return f"thread {record.thread} failed: {told_failure(record.failure)}", Log.ERROR
    if record.succeeded:
        return f"{record.name} succeeded after {record.duration_ns / _NS:.3f} s", Log.INFO
    return f"{record.name} failed: {told_failure(record.failure)}", Log.ERROR


def _task(record: Task) -> tuple[str, Log.Level.ValueType]:
    name = f"{record.kind} {record.name}"
    phase = record.phase
    if phase == Task.ASKED:
        return f"{name} asked for", Log.DEBUG
    if phase == Task.STARTED:
        return f"{name}({values(record.parameters)})", Log.INFO
    took = f"{record.duration_ns / _MS:.1f} ms"
    if record.status == Task.SUCCEEDED:
        return f"{name} succeeded in {took}", Log.INFO
    if record.status == Task.CANCELLED:
        return f"{name} was cancelled after {took}", Log.WARNING
    return f"{name} failed after {took}: {told_failure(record.failure)}", Log.ERROR


def mutation_text(record: Mutation) -> str:
    """What a mutation did, in a few words.

    Args:
        record: the mutation.
    """
    which = str(record.WhichOneof("command") or "change")
    command = getattr(record, which, None)
    tell = _DETAILS.get(which)
    text = which.replace("_", " ") + (f" {tell(command)}" if tell else "")
    if which == "simulate":
        return text
    body = getattr(command, "body", "")
    along = [name for state in record.effect.bodies[:] if (name := state.body) != body]
    return f"{text}, along with {', '.join(along)}" if along else text


def _numbers(values: Sequence[float]) -> str:
    return _THREE % (*values[:],) if len(values) == 3 else f"[{', '.join([f'{value:.3f}' for value in values])}]"


def _joints(command: MoveJoints) -> str:
    one = len(command.joints) == 1
    told = f"{command.joints[0]} {command.positions[0]:.3f}" if one else f"{len(command.joints)} joints"
    return f"{command.body} {told}"


def _fluent(record: Fluent) -> str:
    told = f"fluent {record.name}"
    if record.before_json == record.after_json:
        return f"{told} pulsed at {record.after_json}" if record.after_json else f"{told} pulsed"
    return f"{told}: {record.before_json} -> {record.after_json}"


_DETAILS: Final[Mapping[str, Callable[[Any], str]]] = {  # by command; what isn't here has none
    "open_world": lambda command: str(command.mode),
    "load_body": lambda command: f"{command.body} {_numbers(command.position)}",
    "remove_body": lambda command: command.body,
    "move_body": lambda command: f"{command.body} {_numbers(command.position)}",
    "move_joints": _joints,
    "attach_body": lambda command: f"{command.body} to {command.carrier} {command.carrier_link}",
    "detach_body": lambda command: f"{command.body} from {command.carrier}",
    "set_gravity": lambda command: _numbers(command.gravity),
    "set_realtime": lambda command: "on" if command.enabled else "off",
    "set_color": lambda command: command.body,
    "set_robot": lambda command: command.body,
    "simulate": lambda command: f"{command.steps} steps",
}


_OBJECT: Final = re.compile(r'\{"object":"((?:[^"\\]|\\.)*)","world":"(?:[^"\\]|\\.)*"\}')


def values(arguments: Sequence[Argument]) -> str:
    """Named values in a line; objects go by their names.

    Args:
        arguments: as records carry them.
    """
    return ", ".join([f"{argument.name}={by_name(argument.json)}" for argument in arguments[:]])


def by_name(text: str) -> str:
    """A recorded value with objects by their names.

    Args:
        text: JSON.
    """
    return _OBJECT.sub(r"\1", text) if '{"object":' in text else text
