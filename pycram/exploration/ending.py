"""Endings of runs: how a plan ended, and with what state of its worlds and fluents; which endings are alike.

What ends within a centimetre, 0.1 rad and 0.02 of a joint is in the same place: physics takes each order a little
differently. Plans that fail are alike if they fail in the same way, whatever the state is then.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import Fluent, Keyframe, Mutation, Run, format_failure, without_addresses
from recorder.tracing.journal import NullSink

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from recorder.mcap.sink import McapSink
    from recorder.records import Attachment, BodyState, Effect, Failure, Record
    from recorder.records.values import AssetFile
    from recorder.tracing.journal import Sink

_DISTANCE: Final = 0.01  # m
_ANGLE: Final = 0.1  # rad
_JOINT: Final = 0.02  # rad or m
_NUMBER: Final = 1e-3  # of fluents
_DECIMAL: Final = re.compile(r"-?\d+\.\d+(?:e[+-]?\d+)?")
#: What kinds of endings are called.
SUCCEEDED, FAILED, DEADLOCK, TIME_LIMIT, DIED = "succeeded", "failed", "deadlock", "time limit", "died"

_Body: TypeAlias = "dict[str, list[float]]"  # "position", "orientation" and joints of a body


@dataclass(slots=True)
class Ending:
    """How a run ended.

    Attributes:
        kind: "succeeded", "failed", "deadlock", "time limit" or "died".
        failure: Of a plan that failed, type and message; where the branches wait in a deadlock; else what ended it.
        line: The plan's line that raised it, FILE:LINE; "" if none is known.
        bodies: Of each body in a world, "WORLD/BODY", its pose and joints.
        held: Attached bodies, "WORLD: CARRIER holds BODY".
        fluents: Values of fluents that the plan has set, as JSON.
    """

    kind: str
    failure: str = ""
    line: str = ""
    bodies: dict[str, _Body] = field(default_factory=dict)
    held: list[str] = field(default_factory=list)
    fluents: dict[str, str] = field(default_factory=dict)

    def is_like(self, other: Ending) -> bool:
        """Whether two runs end alike."""
        if self.kind != other.kind:
            return False
        if self.kind == SUCCEEDED:
            return next(iter(self.differences(other)), None) is None
        mine, others = ((_DECIMAL.sub("#", without_addresses(each.failure)), each.line) for each in (self, other))
        return mine == others

    def differences(self, other: Ending) -> Iterator[str]:
        """Yield in words what is otherwise in its state than in another one's."""
        bodies = {**self.bodies, **other.bodies}
        several = len({key.partition("/")[0] for key in bodies}) > 1
        for key in sorted(bodies):
            mine, others = self.bodies.get(key), other.bodies.get(key)
            name = key if several else key.partition("/")[2]
            if mine is None or others is None:
                yield f"{name} {'is gone' if mine is None else 'is there'}"
            else:
                yield from (f"{name} {what}" for what in _moved(mine, others))
        for fact in sorted({*self.held} ^ {*other.held}):
            yield fact if fact in self.held else fact.replace(" holds ", " doesn't hold ")
        for name in sorted({**self.fluents, **other.fluents}):
            mine_json, others_json = self.fluents.get(name), other.fluents.get(name)
            if mine_json is None or others_json is None:
                yield f"fluent {name} {'was never set' if mine_json is None else f'is {mine_json}'}"
            elif not _same(json.loads(mine_json), json.loads(others_json)):
                yield f"fluent {name} is {mine_json} instead of {others_json}"


def _moved(mine: _Body, others: _Body) -> Iterator[str]:
    distance = math.dist(mine["position"], others["position"])
    along = abs(sum(a * b for a, b in zip(mine["orientation"], others["orientation"], strict=True)))
    angle = 2 * math.acos(min(1.0, along))
    if distance > _DISTANCE:
        yield f"ends {distance:.2f} m away"
    elif angle > _ANGLE:
        yield f"ends turned by {math.degrees(angle):.0f} degrees"
    joints = [name for name in mine if name in others and "/" in name]
    moved = [name for name in joints if abs(mine[name][0] - others[name][0]) > _JOINT]
    if moved:
        first = moved[0]
        also = f", and {len(moved) - 1} more joints" if moved[1:] else ""
        yield f"has {first[1:]} at {mine[first][0]:.2f} instead of {others[first][0]:.2f}{also}"


def _same(a: object, b: object) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, int | float) and isinstance(b, int | float) and not isinstance(a, bool) | isinstance(b, bool):
        return a == b or abs(a - b) <= _NUMBER
    if isinstance(a, str) and isinstance(b, str):
        return without_addresses(a) == without_addresses(b)
    return a == b


class EndingSink:
    """Learns from the records of a run how it ends, and hands them on to a file, if there is one.

    Args:
        file: The recording's.

    Attributes:
        ending: How the run has ended; that it died as long as it hasn't.
    """

    def __init__(self, file: McapSink | None = None) -> None:
        self._file: Sink = file or NullSink()
        self._lines: dict[str, str] = {}  # of failures
        self.ending = Ending(DIED, "its process ended")
        if file is not None:
            self.path = file.path  # beside which projections are recorded

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Take a record."""
        self._file.write(topic, record, payload)
        if isinstance(record, Mutation):
            self._change(record.world, record.WhichOneof("command") or "", record.effect)
        elif isinstance(record, Keyframe):
            self._take(record.world, record.bodies)
            self._attach(record.world, record.attachments)
        elif isinstance(record, Fluent):
            if not record.source:
                self.ending.fluents[record.name] = record.after_json
        elif (failure := getattr(record, "failure", None)) is not None and failure.type:
            self._note_line(failure)
        if isinstance(record, Run) and record.phase == Run.FINISHED:
            self._end(record)

    def attach(self, asset: AssetFile) -> None:
        """Take a file."""
        self._file.attach(asset)

    def flush(self) -> None:
        """Make all safe that was taken."""
        self._file.flush()

    def close(self) -> None:
        """End."""
        self._file.close()

    def _change(self, world: str, command: str, effect: Effect) -> None:
        if command == "open_world":  # after another one of that name
            self._forget(world)
        self._take(world, effect.bodies)
        for body in effect.removed:
            self.ending.bodies.pop(f"{world}/{body}", None)
        for each in effect.detached:
            held = _held(world, each)
            if held in self.ending.held:
                self.ending.held.remove(held)
        self._attach(world, effect.attached)

    def _forget(self, world: str) -> None:
        ending = self.ending
        ending.bodies = {name: body for name, body in ending.bodies.items() if name.partition("/")[0] != world}
        ending.held = [each for each in ending.held if not each.startswith(f"{world}: ")]

    def _take(self, world: str, bodies: Iterable[BodyState]) -> None:
        for state in bodies:
            body = self.ending.bodies.setdefault(f"{world}/{state.body}", {"position": [0] * 3, "orientation": [0] * 4})
            if state.position:
                body["position"], body["orientation"] = list(state.position), list(state.orientation)
            for joint, position in zip(state.joints, state.joint_positions, strict=True):
                body[f"/{joint}"] = [position]

    def _attach(self, world: str, attachments: Iterable[Attachment]) -> None:
        for each in attachments:
            if (held := _held(world, each)) not in self.ending.held:
                self.ending.held.append(held)

    def _note_line(self, failure: Failure) -> None:
        if failure.frames:
            innermost = failure.frames[-1]
            self._lines.setdefault(format_failure(failure), f"{innermost.file}:{innermost.line}")

    def _end(self, end: Run) -> None:
        ending = self.ending
        ending.kind, ending.failure = SUCCEEDED, ""
        if not end.succeeded:
            ending.failure = format_failure(end.failure)
            ending.line = self._lines.get(ending.failure, "")
            ending.kind = DEADLOCK if end.failure.type == "DeadlockedBranches" else FAILED


def _held(world: str, each: Attachment) -> str:
    return f"{world}: {each.carrier} holds {each.body}"
