"""One line of text for each record, also for other tools (``foxglove.Log`` on /log).

Lists of records are copied (``[:]``) for iteration: protobuf's own iterators take three times as long.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder.records import (
    STEPS_PER_SECOND,
    Envelope,
    Event,
    Fluent,
    Keyframe,
    Mutation,
    Output,
    Query,
    Refusal,
    Run,
    Subscription,
    Task,
    format_failure,
)
from recorder.records.choices import decision_text, rejections
from recorder.records.projections import foreseen

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from recorder.records import (
        Argument,
        BeginTrajectory,
        Driven,
        LoadBody,
        MoveJoints,
        PathSearch,
        Record,
        Simulate,
    )

_NS: Final = 1_000_000_000
_MS: Final = 1e6
_ASKED, _STARTED, _LEFT = Task.ASKED, Task.STARTED, Task.LEFT  # looked up once
_SUCCEEDED, _CANCELLED = Task.SUCCEEDED, Task.CANCELLED
_DEBUG, _INFO, _WARNING, _ERROR = Log.DEBUG, Log.INFO, Log.WARNING, Log.ERROR
_OF_PLAN: Final = frozenset({Task, Run, Output})
_LEVELS: Final = {
    "DEBUG": _DEBUG,
    "INFO": _INFO,
    "WARNING": _WARNING,
    "ERROR": _ERROR,
    "CRITICAL": _ERROR,
}  # of logging
_NOTABLE_ERROR: Final = 0.01  # rad or m: less is the lag of motors
_THREE: Final = "[%.3f, %.3f, %.3f]"  # for most values, and faster than a format for any number of them


class Lines:
    """Makes the lines of some records in one message, which takes half as long as one message each.

    For few of them, as the message keeps the memory of all its texts.
    """

    def __init__(self) -> None:
        self._line = Log()
        self._moment = self._line.timestamp

    def of(self, record: Record, time_ns: int) -> bytes | None:
        """The line of a record, serialized, at a time in ns since the Unix epoch; None if it has none."""
        if not has_line(record):
            return None
        kind, line, moment = type(record), self._line, self._moment
        line.message, line.level = _TEXTS[kind](record)
        line.name = "plan" if kind in _OF_PLAN else record.world or "plan"
        moment.seconds, moment.nanos = divmod(time_ns, _NS)
        return line.SerializeToString()


def has_line(record: Record) -> bool:
    """Whether a record has a line: keyframes have none, nor tasks that are only asked for."""
    if type(record) is Task:  # isinstance takes five times as long where it is none
        return record.phase != _ASKED
    return type(record) is not Keyframe


def text_of(record: Record) -> tuple[str, Log.Level.ValueType]:
    """A record as text, with its level."""
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
        return f"{name}({values(record.parameters)}){', which runs already' if record.began_ns else ''}", _INFO
    if phase == _ASKED:
        return f"{name} asked for", _DEBUG
    if phase == _LEFT:
        return f"{name} goes on when the recording ends", _INFO
    took, status = f"{record.duration_ns / _MS:.1f} ms", record.status
    if status == _SUCCEEDED:
        return f"{name} succeeded in {took}{_decided(record)}" + (
            f": {text}" if (text := foreseen(record)) else ""
        ), _INFO
    if status == _CANCELLED:
        return f"{name} was cancelled after {took}", _WARNING
    return f"{name} failed after {took}{_decided(record)}: {format_failure(record.failure)}", _ERROR


def _decided(record: Task) -> str:
    """How a motion was decided, where that isn't as by default."""
    known = record.kind == "motion" and record.HasField("decision")  # its process module has the same
    text = decision_text(record.decision) if known else ""
    return f", {text}" if text else ""


def _query(record: Query) -> tuple[str, Log.Level.ValueType]:
    asked = f"{record.name}({values(record.arguments)})"
    rejected = f"; {text}" if record.candidates and (text := rejections(record)) else ""
    if record.HasField("failure"):
        return f"{asked} raised {record.failure.type}{rejected}", _WARNING
    by = f", by the fork; else {by_name(record.own_answer_json)}" if record.by_fork else ""
    return f"{asked} -> {by_name(record.answer_json)}{by}{rejected}", _INFO


def _event(record: Event) -> tuple[str, Log.Level.ValueType]:
    return f"event {record.name}({values(record.arguments)}), {len(record.handlers)} handlers", _INFO


def _output(record: Output) -> tuple[str, Log.Level.ValueType]:
    if record.stream == "logging":
        return f"{record.logger} {record.level}: {record.text}", _LEVELS.get(record.level, _INFO)
    return f"{record.stream}: {record.text}", _WARNING if record.stream == "stderr" else _INFO


def _subscription(record: Subscription) -> tuple[str, Log.Level.ValueType]:
    change = "removed from" if record.removed else "added to"
    sender = f" of {record.sender}" if record.sender else ""
    return f"handler {record.handler} {change} event {record.name}{sender}", _DEBUG


def _refusal(record: Refusal) -> tuple[str, Log.Level.ValueType]:
    return f"refused: {record.name}({values(record.arguments)}): {format_failure(record.failure)}", _WARNING


def mutation_text(record: Mutation) -> str:
    """What a mutation did, in a few words."""
    name = str(record.WhichOneof("command") or "change")
    command = getattr(record, name, None)
    details = _DETAILS.get(name)
    text = name.replace("_", " ") + (f" {details(command)}" if details else "")
    text += ", by the fork" if record.by_fork else ""
    if name == "simulate":
        dragged = " and ".join(dict.fromkeys(drag.body for drag in record.drags[:]))
        return f"{text}, while {dragged} was dragged by hand" if dragged else text
    body = getattr(command, "body", "")
    along = [name for state in record.effect.bodies[:] if (name := state.body) != body]
    return f"{text}, along with {', '.join(along)}" if along else text


def _numbers(values: Sequence[float]) -> str:
    numbers = (*values[:],)
    return _THREE % numbers if len(numbers) == 3 else f"[{', '.join([f'{number:.3f}' for number in numbers])}]"


def _joints(command: MoveJoints) -> str:
    count = len(command.joints)
    details = f"{command.joints[0]} {command.positions[0]:.3f}" if count == 1 else f"{count} joints"
    return f"{command.body} {details}"


def _loaded(command: LoadBody) -> str:
    inside = ", ".join([f"{overlap.depth * 1e3:.0f} mm inside of {overlap.body}" for overlap in command.overlaps[:]])
    return f"{command.body} {_numbers(command.position)}" + (f", {inside}" if inside else "")


def _simulated(command: Simulate) -> str:
    steps = f"{command.steps} steps"
    if command.driven:
        return f"{steps}, {', '.join([_driven(each) for each in command.driven[:]])}"
    if not command.HasField("settled"):
        return steps
    return f"{steps} until all was at rest" if command.settled else f"{steps}; not all is at rest yet"


def _driven(driven: Driven) -> str:
    """How far a trajectory got in a simulation."""
    off = f" ({driven.joint} {driven.error:.3f} off)" if driven.error > _NOTABLE_ERROR else ""
    at = f"{driven.body} at {driven.time:.3f} s of trajectory {driven.number}"
    return f"{at}, which has ended{off}" if driven.ended else f"{at}{off}"


def _began(command: BeginTrajectory) -> str:
    trajectory = command.trajectory
    count = len(trajectory.joints)
    moved = f"{count} joints" if count > 1 else trajectory.joints[0] if count else "base"
    took = f"{trajectory.times[-1]:.3f} s" if trajectory.times else "no time"
    return f"{command.number}: {moved} of {command.body}, {took}{_searched(command.search)}"


def _searched(search: PathSearch) -> str:
    """How the path of a trajectory was found."""
    if not search.planner:
        return ""
    checks = f" after {search.checks} checks" if search.checks else ""
    planner = "along a given path" if search.planner == "given" else search.planner
    return f", {planner}{checks}"


def _fluent(record: Fluent) -> tuple[str, Log.Level.ValueType]:
    name, after = f"fluent {record.name}", record.after_json
    if record.by_fork:
        return f"{name}: {record.before_json} -> {after}, by the fork", _DEBUG
    if record.before_json == after:
        return f"{name} pulsed at {after}" if after else f"{name} pulsed", _DEBUG
    return f"{name}: {record.before_json} -> {after}", _DEBUG


_TEXTS: Final[Mapping[type[Record], Callable[[Any], tuple[str, Log.Level.ValueType]]]] = {
    Task: _task,
    Mutation: lambda record: (mutation_text(record), _DEBUG),
    Query: _query,
    Event: _event,
    Subscription: _subscription,
    Refusal: _refusal,
    Fluent: _fluent,
    Run: _run,
    Output: _output,
    Keyframe: lambda record: (f"keyframe of {record.world}", _DEBUG),
    Envelope: lambda _: ("a record of a kind that this release doesn't know", _DEBUG),
}

_DETAILS: Final[Mapping[str, Callable[[Any], str]]] = {  # by command; others have none
    "open_world": lambda command: str(command.mode),
    "load_body": _loaded,
    "remove_body": lambda command: command.body,
    "move_body": lambda command: f"{command.body} {_numbers(command.position)}",
    "move_joints": _joints,
    "attach_body": lambda command: f"{command.body} to {command.carrier} {command.carrier_link}",
    "detach_body": lambda command: f"{command.body} from {command.carrier}",
    "set_gravity": lambda command: _numbers(command.gravity),
    "set_realtime": lambda command: "on" if command.enabled else "off",
    "set_color": lambda command: command.body,
    "set_robot": lambda command: command.body,
    "simulate": _simulated,
    "begin_trajectory": _began,
    "stop_trajectory": lambda command: f"{command.number} of {command.body}",
    "restore": lambda command: f"what was saved at {command.sim_step / STEPS_PER_SECOND:.3f} s",
}


_OBJECT: Final = re.compile(r'\{"object":"((?:[^"\\]|\\.)*)","world":"(?:[^"\\]|\\.)*"\}')


def values(arguments: Sequence[Argument]) -> str:
    """Recorded values in a line, objects by their names."""
    return ", ".join([f"{argument.name}={by_name(argument.json)}" for argument in arguments[:]]) if arguments else ""


def by_name(text: str) -> str:
    """A recorded value (JSON) with objects by their names."""
    return _OBJECT.sub(r"\1", text) if '{"object":' in text else text
