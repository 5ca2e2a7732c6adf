"""What happened in one line each, for people who look at a recording with other tools (``foxglove.Log`` on /log).

Lists of records are copied (``[:]``) to go through them: protobuf's own iterators take three times as long.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder.records import Event, Fluent, Keyframe, Mutation, Query, Run, Task, format_failure

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from recorder.records import Argument, MoveJoints, Record

_NS: Final = 1_000_000_000
_MS: Final = 1e6
_ASKED, _STARTED, _SUCCEEDED, _CANCELLED = Task.ASKED, Task.STARTED, Task.SUCCEEDED, Task.CANCELLED  # looked up once
_DEBUG, _INFO, _WARNING, _ERROR = Log.DEBUG, Log.INFO, Log.WARNING, Log.ERROR
_THREE: Final = "[%.3f, %.3f, %.3f]"  # of most values, and faster than what fits any number of them


class Lines:
    """Lines for records, one after the other: in one message that is filled anew each time, which takes half as long.

    For few of them, as the message keeps the room that all its texts have taken.
    """

    def __init__(self) -> None:
        self._line = Log()
        self._moment = self._line.timestamp

    def of(self, record: Record, time_ns: int) -> bytes | None:
        """The line for a record, serialized.

        Args:
            record: any.
            time_ns: when it was, in ns since the Unix epoch.

        Returns:
            None where there is nothing to say; see :func:`has_line`.
        """
        if not has_line(record):
            return None
        kind, line, moment = type(record), self._line, self._moment
        line.message, line.level = _TEXTS[kind](record)
        line.name = "plan" if kind is Task or kind is Run else record.world or "plan"
        moment.seconds, moment.nanos = divmod(time_ns, _NS)
        return line.SerializeToString()


def has_line(record: Record) -> bool:
    """Whether there is something to say: not of keyframes, nor of tasks that are only asked for.

    Args:
        record: any.
    """
    if type(record) is Task:  # isinstance takes five times as long where it is none
        return record.phase != _ASKED
    return type(record) is not Keyframe


def text_of(record: Record) -> tuple[str, Log.Level.ValueType]:
    """The same as plain text, with its level.

    Args:
        record: any.
    """
    return _TEXTS[type(record)](record)


def _run(record: Run) -> tuple[str, Log.Level.ValueType]:
    if record.phase == Run.STARTED:
        return f"{record.name} started", _INFO
    if record.phase == Run.THREAD_FAILED:
        return f"thread {record.thread} failed: {format_failure(record.failure)}", _ERROR
    if record.succeeded:
        return f"{record.name} succeeded after {record.duration_ns / _NS:.3f} s", _INFO
    return f"{record.name} failed: {format_failure(record.failure)}", _ERROR


def _task(record: Task) -> tuple[str, Log.Level.ValueType]:
    name, phase = f"{record.kind} {record.name}", record.phase
    if phase == _STARTED:
        return f"{name}({values(record.parameters)})", _INFO
    if phase == _ASKED:
        return f"{name} asked for", _DEBUG
    took, status = f"{record.duration_ns / _MS:.1f} ms", record.status
    if status == _SUCCEEDED:
        return f"{name} succeeded in {took}", _INFO
    if status == _CANCELLED:
        return f"{name} was cancelled after {took}", _WARNING
    return f"{name} failed after {took}: {format_failure(record.failure)}", _ERROR


def _query(record: Query) -> tuple[str, Log.Level.ValueType]:
    asked = f"{record.name}({values(record.arguments)})"
    if record.HasField("failure"):
        return f"{asked} raised {record.failure.type}", _WARNING
    return f"{asked} -> {by_name(record.answer_json)}", _INFO


def _event(record: Event) -> tuple[str, Log.Level.ValueType]:
    return f"event {record.name}({values(record.arguments)}), {len(record.handlers)} handlers", _INFO


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
    told = (*values[:],)
    return _THREE % told if len(told) == 3 else f"[{', '.join([f'{value:.3f}' for value in told])}]"


def _joints(command: MoveJoints) -> str:
    one = len(command.joints) == 1
    told = f"{command.joints[0]} {command.positions[0]:.3f}" if one else f"{len(command.joints)} joints"
    return f"{command.body} {told}"


def _fluent(record: Fluent) -> tuple[str, Log.Level.ValueType]:
    told, after = f"fluent {record.name}", record.after_json
    if record.before_json == after:
        return f"{told} pulsed at {after}" if after else f"{told} pulsed", _DEBUG
    return f"{told}: {record.before_json} -> {after}", _DEBUG


_TEXTS: Final[Mapping[type[Record], Callable[[Any], tuple[str, Log.Level.ValueType]]]] = {
    Task: _task,
    Mutation: lambda record: (mutation_text(record), _DEBUG),
    Query: _query,
    Event: _event,
    Fluent: _fluent,
    Run: _run,
    Keyframe: lambda record: (f"keyframe of {record.world}", _DEBUG),
}

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
    return ", ".join([f"{argument.name}={by_name(argument.json)}" for argument in arguments[:]]) if arguments else ""


def by_name(text: str) -> str:
    """A recorded value with objects by their names.

    Args:
        text: JSON.
    """
    return _OBJECT.sub(r"\1", text) if '{"object":' in text else text
