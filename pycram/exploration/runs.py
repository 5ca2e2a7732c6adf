"""Runs of a plan in given orders of its branches, in child processes, and their endings: which runs end alike.

The children are forked from this process, which has imported the modules of plans. So a run costs what the plan costs.

Positions within a centimetre, 0.1 rad and 0.02 of a joint are equal, because physics computes each order a little
differently. Failed plans end alike if they fail in the same way, whatever their state.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections import deque
from contextlib import closing
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy.random  # noqa: F401  to be seeded in each run, which else would import it again

from pycram.projection.child import usable_cores
from pycram.projection.pool import GRACE, ChildPool, run_from_start
from pycram.scheduling.order import Made, Precedence, Standing
from pycram.scheduling.schedule import scheduler
from recorder.mcap_sink import McapSink
from recorder.provenance import metadata
from recorder.recording import redirected
from recorder.records import Fluent, Keyframe, Mutation, Run, format_failure, without_addresses
from recorder.tracing.journal import NullSink

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Mapping

    from pycram.projection.child import Child
    from pycram.projection.pool import ChildResult
    from recorder.records import Attachment, BodyState, Effect, Record
    from recorder.records.values import AssetFile
    from recorder.tracing.journal import Sink


#: Runs the plan in an order, given as text, and records it; doesn't raise.
Runner: TypeAlias = "Callable[[str, Path], object]"
_DISTANCE: Final = 0.01  # m
_ANGLE: Final = 0.1  # rad
_JOINT: Final = 0.02  # rad or m
_NUMBER: Final = 1e-3  # of fluents
_DECIMAL: Final = re.compile(r"-?\d+\.\d+(?:e[+-]?\d+)?")
#: Kinds of endings.
SUCCEEDED, FAILED, DEADLOCK, TIME_LIMIT, DIED = "succeeded", "failed", "deadlock", "time limit", "died"

_Body: TypeAlias = "dict[str, list[float]]"  # "position", "orientation" and joints of a body


@dataclass(frozen=True, slots=True)
class OrderedRun:
    """A run in a given order."""

    order: str  # that was asked for
    ending: Ending
    turns: int  # with two or more branches to choose from
    made: tuple[Made, ...]  # its order, as exceptions from the ranks of branches
    seconds: float

    @property
    def precedences(self) -> tuple[Precedence, ...]:
        """Its order."""
        return tuple([each.precedence for each in self.made])


class PlanRunner:
    """Runs a plan in many orders; interrupts a run after a limit in s of wall-clock time."""

    def __init__(self, run: Runner, limit: float) -> None:
        self._run = run
        self.cores = usable_cores()
        self._limit = limit

    def all(self, orders: Iterable[str], file: Path | None = None) -> Generator[tuple[int, OrderedRun], None, None]:
        """Run it in orders in parallel; yield each run with its index, as they end; closing kills the other runs."""
        pool: ChildPool[tuple[int, str]] = ChildPool(self.cores, self._limit, GRACE)

        def start(job: tuple[int, str]) -> Child:
            return run_from_start(partial(_run_in_order, self._run, job[1], file))

        with closing(pool.run(deque(enumerate(orders)), start)) as results:
            for (index, order), result in results:
                yield index, self._ended(order, result)

    def _ended(self, order: str, result: ChildResult) -> OrderedRun:
        ending, turns = Ending(DIED, f"its process {result.how}"), 0
        made: tuple[Made, ...] = ()
        if result.answer:
            answer: Mapping[str, Any] = json.loads(result.answer)
            ending, turns = Ending(**answer["ending"]), answer["turns"]
            made = tuple(
                Made(Precedence(*own), Standing(*first), Standing(*second), [Precedence(*each) for each in passed])
                for own, first, second, passed in answer["made"]
            )
        if result.late:
            ending = Ending(TIME_LIMIT, f"it still ran after {self._limit:g} s")
        return OrderedRun(order, ending, turns, made, result.seconds)


def _run_in_order(run: Runner, order: str, file: Path | None) -> bytes:
    """Run the plan, in a child; only its first recording goes to the file."""
    path = file or Path(os.devnull)
    sinks: list[EndingSink] = []

    def sink_of(began: Run) -> Sink:
        sinks.append(EndingSink(McapSink(path, metadata(began)) if file is not None and not sinks else None))
        return sinks[-1]

    with redirected(sink_of):
        run(order, path)
    ending = sinks[0].ending if sinks else Ending(DIED, "it couldn't be recorded")
    asked = scheduler().order
    turns, made = (0, []) if asked is None else (asked.turns, asked.made)
    return json.dumps({"ending": asdict(ending), "turns": turns, "made": made}).encode()


@dataclass(slots=True)
class Ending:
    """The ending of a run, with the final state of its worlds and fluents."""

    kind: str  # "succeeded", "failed", "deadlock", "time limit" or "died"
    failure: str = ""  # type and message of the plan's failure; where branches wait in a deadlock; or the cause
    line: str = ""  # the plan's line that raised the failure, FILE:LINE; "" if unknown
    bodies: dict[str, _Body] = field(default_factory=dict)  # by "WORLD/BODY"
    held: list[str] = field(default_factory=list)  # attached bodies, "WORLD: CARRIER holds BODY"
    fluents: dict[str, str] = field(default_factory=dict)  # set by the plan, as JSON

    def is_like(self, other: Ending) -> bool:
        """Return whether two runs end alike."""
        if self.kind != other.kind:
            return False
        if self.kind == SUCCEEDED:
            return next(iter(self.differences(other)), None) is None
        mine, others = ((_DECIMAL.sub("#", without_addresses(each.failure)), each.line) for each in (self, other))
        return mine == others

    def differences(self, other: Ending) -> Iterator[str]:
        """Yield the differences of its state from another ending's, in words."""
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
    """Computes the ending of a run from its records, and forwards them to a file, if there is one."""

    def __init__(self, file: McapSink | None = None) -> None:
        self._file: Sink = file or NullSink()
        self._lines: dict[str, str] = {}  # of failures
        self.ending = Ending(DIED, "its process ended")  # until the record of its end
        if file is not None:
            self.path = file.path  # projections are recorded next to it

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Evaluate and forward a record."""
        self._file.write(topic, record, payload)
        if isinstance(record, Mutation):
            self._change(record.world, record.WhichOneof("command") or "", record.effect)
        elif isinstance(record, Keyframe):
            self._take(record.world, record.bodies)
            self._attach(record.world, record.attachments)
        elif isinstance(record, Fluent):
            if not record.source:
                self.ending.fluents[record.name] = record.after_json
        elif (failure := getattr(record, "failure", None)) is not None and failure.type and failure.frames:
            innermost = failure.frames[-1]
            self._lines.setdefault(format_failure(failure), f"{innermost.file}:{innermost.line}")
        if isinstance(record, Run) and record.phase == Run.FINISHED:
            self._end(record)

    def attach(self, asset: AssetFile) -> None:
        """Forward a file."""
        self._file.attach(asset)

    def flush(self) -> None:
        """Flush the file."""
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _change(self, world: str, command: str, effect: Effect) -> None:
        ending = self.ending
        if command == "open_world":  # replaces an earlier world of that name
            ending.bodies = {name: body for name, body in ending.bodies.items() if name.partition("/")[0] != world}
            ending.held = [each for each in ending.held if not each.startswith(f"{world}: ")]
        self._take(world, effect.bodies)
        for body in effect.removed:
            ending.bodies.pop(f"{world}/{body}", None)
        for each in effect.detached:
            held = _held(world, each)
            if held in ending.held:
                ending.held.remove(held)
        self._attach(world, effect.attached)

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

    def _end(self, end: Run) -> None:
        ending = self.ending
        ending.kind, ending.failure = SUCCEEDED, ""
        if not end.succeeded:
            ending.failure = format_failure(end.failure)
            ending.line = self._lines.get(ending.failure, "")
            ending.kind = DEADLOCK if end.failure.type == "DeadlockedBranches" else FAILED


def _held(world: str, each: Attachment) -> str:
    return f"{world}: {each.carrier} holds {each.body}"
