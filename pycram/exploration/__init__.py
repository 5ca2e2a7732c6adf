"""Exploration: a plan runs in many orders of its branches, to find races: orders with different endings.

The first run takes branches in the order in which they were added; :class:`~pycram.scheduling.order.Pct` draws the
other orders. Delta debugging minimises the precedences for each ending (Zeller and Hildebrandt: Simplifying and
isolating failure-inducing input, IEEE TSE 2002): if any precedence is removed, the run ends in another way.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy.random  # noqa: F401  each run seeds NumPy, and would otherwise import it

from pycram.foundation import checks
from pycram.foundation.errors import export
from pycram.foundation.failures import BadArgument, UsageError
from pycram.projection.child import GRACE, Child, ChildPool, ChildResult, obstacle, run_from_start, usable_cores
from pycram.running import seed_random_numbers
from pycram.scheduling.order import ADDED, AppliedPrecedence, BranchLine, Precedence, text_of
from pycram.scheduling.schedule import refuse_held, scheduler, seed_order
from recorder.errors import RecordingError
from recorder.mcap_sink import McapSink, free_path
from recorder.plan_lines import deciding
from recorder.provenance import look_up_revisions, metadata
from recorder.recording import record, redirected
from recorder.records import Check, Fluent, Keyframe, Mutation, Record, Run, format_failure, without_addresses
from recorder.records.fold import FoldedWorld, apply
from recorder.tracing.journal import NullSink, Sink

__all__ = [
    "DEADLOCK",
    "DIED",
    "FAILED",
    "SUCCEEDED",
    "TIME_LIMIT",
    "VIOLATED",
    "EndingGroup",
    "Exploration",
    "NotExplorable",
    "explore",
]

#: Runs the plan in an order, which is given as text, and records the run into a file.
Runner: TypeAlias = "Callable[[str, Path], object]"
_Body: TypeAlias = "dict[str, list[float]]"  # the pose of a body ("position", "orientation") and its joints ("/JOINT")

#: Kinds of endings.
SUCCEEDED, FAILED, DEADLOCK, TIME_LIMIT, DIED = "succeeded", "failed", "deadlock", "time limit", "died"
VIOLATED = "succeeded but violated"  # the run violated a property, but the violation was only recorded
_WITH_ORDER: Final = (SUCCEEDED, FAILED, DEADLOCK, VIOLATED)  # kinds of endings of runs with a known order
DEPTH: Final = 3  # default depth of races; most known races have no greater depth (Burckhardt et al.)
LIMIT: Final = 60.0  # default limit of a run's wall-clock time, in s
_ROUND: Final = 16  # number of runs in a round; all orders of a round assume the same number of turns of branches
_EXPLAINED: Final = 8  # maximum number of explained endings; each run might have another ending
_MAX_TRIES: Final = 200  # maximum number of runs in the search for the precedences that cause an ending
# Physics computes each order a little differently, so states count as equal up to these differences.
_DISTANCE: Final = 0.01  # m
_ANGLE: Final = 0.1  # rad
_JOINT: Final = 0.02  # rad or m
_NUMBER: Final = 1e-3  # difference of numbers in fluents that count as equal
_DECIMAL: Final = re.compile(r"-?\d+\.\d+(?:e[+-]?\d+)?")


class NotExplorable(UsageError):
    """An action can't be explored, because the process can't be copied."""

    def __init__(self, cause: str) -> None:
        super().__init__(f"orders can't be explored here: {cause}")
        self.cause = cause  # why the process can't be copied, and a remedy


export("pycram.exploration", NotExplorable)


@dataclass(slots=True)
class EndingGroup:
    """Runs with the same ending."""

    ending: Ending  # ending of the first of these runs
    count: int
    order: str  # smallest known order of branches with this ending, as text (:mod:`pycram.scheduling.order`)
    #: Precedences of branches that together cause this ending; empty for the first ending, or if unknown.
    made: tuple[AppliedPrecedence, ...] = ()
    recording: Path | None = None  # recording of a run in that order


@dataclass(slots=True)
class Exploration:
    """The results of running a plan in many orders."""

    runs: int  # number of ended runs
    orders: int  # number of different orders of these runs
    found: list[EndingGroup]  # groups of runs, ordered by their first runs
    deterministic: bool = True  # whether all runs in the same order had the same ending
    interrupted: bool = False  # whether Ctrl-C ended the exploration

    @property
    def reference(self) -> Ending | None:
        """The first successful ending, with which other successful endings are compared; None if all runs failed."""
        return next((each.ending for each in self.found if each.ending.kind == SUCCEEDED), None)

    @property
    def alike(self) -> bool:
        """Whether all runs had the same ending."""
        return len(self.found) < 2 and self.deterministic


def explore(
    action: Callable[[], object],
    runs: int = 100,
    *,
    seed: int = 0,
    depth: int = DEPTH,
    limit: float = LIMIT,
    folder: str | Path | None = None,
) -> Exploration:
    """Run an action in many orders of its branches. Each run is in a copy of this process, so nothing changes here.

    Args:
        seed: Seed of the random numbers in every run, and of the drawn orders.
        depth: Maximum depth of the races: the number of precedences that together cause a race.
        limit: Seconds of wall-clock time for each run.
        folder: Folder for a recording of each ending; None keeps no recordings.

    Raises:
        NotExplorable: A world has a window or runs in real time, the plan has other threads, or the system can't fork.
        BadArgument: An argument is out of range, or the action isn't a function.
        LockHeld: The caller holds a lock.
        RecordingError: The folder doesn't exist.
    """
    refuse_held()
    if not callable(action):
        raise BadArgument("action", action, "a function of the plan")
    name = getattr(action, "__name__", "action")

    def run(order: str, path: Path) -> None:
        seed_random_numbers(seed)
        seed_order(seed, order)
        with (
            suppress(BaseException),  # the recording contains the error
            record(path, name=name, arguments=(), seed=seed, order=order, output=True, overwrite=True),
        ):
            action()

    file = None if folder is None else Path(folder) / f"{name}.mcap"
    return explore_runs(run, runs, depth=depth, limit=limit, file=file)


def explore_runs(
    run: Runner,
    count: int,
    *,
    depth: int = DEPTH,
    limit: float = LIMIT,
    plan: Path | None = None,
    file: Path | None = None,
    overwrite: bool = False,
    progress: Callable[[int], None] = lambda _: None,
) -> Exploration:
    """Explore a plan; ``run`` runs the plan once. :func:`explore` describes other arguments and errors.

    If ``file`` is RUN.mcap, recordings are named RUN.explored-1.mcap, ...; None keeps no recordings. ``plan`` is the
    file of the plan; None for the program. ``progress`` is called after each run with the number of ended runs.
    """
    checks.count("runs", count, least=1)
    checks.count("depth", depth, least=1)
    if checks.number("limit", limit) <= 0:
        raise BadArgument("limit", limit, "seconds, more than 0")
    if cause := obstacle():
        raise NotExplorable(cause)
    if file is not None and not file.parent.is_dir():  # checked first, because files are written only after all runs
        raise RecordingError(file, "No such file or directory", "make the folder first")
    look_up_revisions(plan)
    runner = PlanRunner(run, limit)
    result = Exploration(0, 0, [])
    attempts: dict[int, OrderedRun] = {}
    try:
        for orders in _orders(count, depth, attempts):
            begun = len(attempts)
            with closing(runner.all(orders)) as ended:
                for index, attempt in ended:
                    attempts[begun + index] = attempt
                    progress(len(attempts))
        _sort(attempts, result)
        _decide(runner, result, attempts)
        if len(result.found) > 1 or file is not None:
            _run_again(runner, result, file, overwrite=overwrite)
    except KeyboardInterrupt:
        _sort(attempts, result)
        result.interrupted = True
    return result


def _orders(count: int, depth: int, attempts: dict[int, OrderedRun]) -> Iterator[Sequence[str]]:
    """Yield the orders of each round. Orders change at random turns, up to the number of turns of the longest run."""
    yield [ADDED]
    for start in range(1, count, _ROUND):
        turns = max(attempt.turns for attempt in attempts.values())
        if not turns:  # no run had a choice between branches
            return
        yield [f"pct:{number}:{depth}:{turns}" for number in range(start, min(start + _ROUND, count))]


def _sort(attempts: Mapping[int, OrderedRun], result: Exploration) -> None:
    if not result.runs:  # otherwise the runs are already grouped
        for _, attempt in sorted(attempts.items()):
            like = next((each for each in result.found if each.ending.is_like(attempt.ending)), None)
            if like is None:
                result.found.append(EndingGroup(attempt.ending, 1, attempt.order))
            else:
                like.count += 1
    result.runs = len(attempts)
    result.orders = len({attempt.precedences for attempt in attempts.values()})


def _decide(runs: PlanRunner, result: Exploration, attempts: Mapping[int, OrderedRun]) -> None:
    """If runs end in different ways, find the few precedences that cause each ending."""
    if len(result.found) < 2:
        return
    again = [each for each in result.found[:_EXPLAINED] if each.ending.kind in _WITH_ORDER] * 2
    for index, attempt in runs.all([each.order for each in again]):
        result.deterministic &= attempt.ending.is_like(again[index].ending)
    for found in result.found[1:_EXPLAINED] if result.deterministic else ():
        if found.ending.kind in _WITH_ORDER:
            of_it = [each for each in attempts.values() if each.ending.is_like(found.ending)]
            least = _reduced(runs, min(of_it, key=lambda attempt: len(attempt.made)).precedences, found.ending)
            if least is None:
                result.deterministic = False
                return
            found.order = text_of(least.precedences)


def _run_again(runs: PlanRunner, result: Exploration, file: Path | None, *, overwrite: bool) -> None:
    """Run the smallest order of each ending again, to record the run and the lines of its branches."""
    for number, found in enumerate(result.found[:_EXPLAINED], 1):
        name = None if file is None else file.with_name(f"{file.stem}.explored-{number}{file.suffix}")
        if name is not None and not overwrite:
            name = free_path(name)
        ((_, attempt),) = runs.all([found.order], name)
        if not attempt.ending.is_like(found.ending):
            result.deterministic = False
        found.recording = name
        found.made = attempt.made if found.order.startswith(ADDED) else ()


class _Tries:
    """Runs the plan with sets of precedences, once for each set, to find the set that causes a certain ending."""

    def __init__(self, runs: PlanRunner, ending: Ending) -> None:
        self._runs = runs
        self._ending = ending
        self._known: dict[tuple[Precedence, ...], OrderedRun] = {}

    def first_of(self, tries: Sequence[Sequence[Precedence]]) -> OrderedRun | None:
        """Return the first run with that ending; None if no run has it. At most one run per core is in progress."""
        for start in range(0, len(tries), self._runs.cores):
            wave = [tuple(each) for each in tries[start : start + self._runs.cores]]
            new = [each for each in wave if each not in self._known][: _MAX_TRIES - len(self._known)]
            for index, attempt in self._runs.all([text_of(each) for each in new]):
                self._known[new[index]] = attempt
            for each in wave:
                if each in self._known and self._known[each].ending.is_like(self._ending):
                    return self._known[each]
        return None


def _reduced(runs: PlanRunner, precedences: Sequence[Precedence], ending: Ending) -> OrderedRun | None:
    """Return a run with the wanted ending and as few precedences as possible; None if the plan isn't deterministic."""
    tries = _Tries(runs, ending)
    best = tries.first_of([precedences])
    parts = 2
    while best is not None and parts <= len(best.precedences):
        least = best.precedences
        cuts = [len(least) * part // parts for part in range(parts + 1)]
        chunks = [(least[:a], least[a:b], least[b:]) for a, b in pairwise(cuts)]
        some = tries.first_of([chunk for _, chunk, _ in chunks])
        rest = some or tries.first_of([(*before, *after) for before, _, after in chunks])
        if rest is None:
            parts = len(least) if parts < len(least) else parts + 1
        else:
            best, parts = rest, 2 if some else max(parts - 1, 2)
    return best and _nearer(tries, best)


def _nearer(tries: _Tries, best: OrderedRun) -> OrderedRun:
    """Return a run with weaker precedences: each puts a branch before as few other branches as possible."""
    for at in range(len(best.made)):
        made = best.precedences
        found = tries.first_of([(*made[:at], passed, *made[at + 1 :]) for passed in best.made[at].passed])
        if found is not None and len(found.made) == len(made):
            best = found
    return best


@dataclass(frozen=True, slots=True)
class OrderedRun:
    """A run in a given order."""

    order: str  # the requested order
    ending: Ending
    turns: int  # number of turns with two or more ready branches
    made: tuple[AppliedPrecedence, ...]  # order of the run, as exceptions from the order by ranks
    seconds: float

    @property
    def precedences(self) -> tuple[Precedence, ...]:
        """The order of the run, without the lines of its branches."""
        return tuple([each.precedence for each in self.made])


class PlanRunner:
    """Runs a plan in many orders; a run is interrupted after ``limit`` seconds of wall-clock time."""

    def __init__(self, run: Runner, limit: float) -> None:
        self._run = run
        self.cores = usable_cores()
        self._limit = limit

    def all(self, orders: Iterable[str], file: Path | None = None) -> Generator[tuple[int, OrderedRun], None, None]:
        """Run orders in parallel; yield each index and run at its end. Closing the generator kills running plans."""
        pool: ChildPool[tuple[int, str]] = ChildPool(self.cores, self._limit, GRACE)

        def start(job: tuple[int, str]) -> Child:
            return run_from_start(partial(_run_in_order, self._run, job[1], file))

        with closing(pool.run(deque(enumerate(orders)), start)) as results:
            for (index, order), result in results:
                yield index, self._ended(order, result)

    def _ended(self, order: str, result: ChildResult) -> OrderedRun:
        ending, turns = Ending(DIED, f"the process {result.how}"), 0
        made: tuple[AppliedPrecedence, ...] = ()
        if result.answer:
            answer: Mapping[str, Any] = json.loads(result.answer)
            ending, turns = Ending(**answer["ending"]), answer["turns"]
            made = tuple(
                AppliedPrecedence(
                    Precedence(*own), BranchLine(*first), BranchLine(*second), [Precedence(*each) for each in passed]
                )
                for own, first, second, passed in answer["made"]
            )
        if result.late:
            ending = Ending(TIME_LIMIT, f"the run was still running after {self._limit:g} s")
        return OrderedRun(order, ending, turns, made, result.seconds)


def _run_in_order(run: Runner, order: str, file: Path | None) -> bytes:
    """Run the plan in this child process; only its first recording is written to the file."""
    path = file or Path(os.devnull)
    sinks: list[EndingSink] = []

    def sink_of(began: Run) -> Sink:
        sinks.append(EndingSink(McapSink(path, metadata(began)) if file is not None and not sinks else None))
        return sinks[-1]

    with redirected(sink_of):
        run(order, path)
    ending = sinks[0].ending if sinks else Ending(DIED, "the run couldn't be recorded")
    asked = scheduler().order
    turns, made = (0, []) if asked is None else (asked.turns, asked.applied)
    return json.dumps({"ending": asdict(ending), "turns": turns, "made": made}).encode()


@dataclass(slots=True)
class Ending:
    """The ending of a run: its outcome, and the final state of its worlds and fluents."""

    kind: str  # "succeeded", "succeeded but violated", "failed", "deadlock", "time limit" or "died"
    #: Type and message of the plan's failure, or the violated properties, or the cause of another ending.
    failure: str = ""
    line: str = ""  # innermost line of the plan's code in the failure's traceback, FILE:LINE; "" if unknown
    plan_line: str = ""  # innermost line of the plan's main file in the same traceback
    bodies: dict[str, _Body] = field(default_factory=dict)  # states of bodies by "WORLD/BODY"
    held: list[str] = field(default_factory=list)  # attachments: "WORLD: CARRIER holds BODY"
    fluents: dict[str, str] = field(default_factory=dict)  # fluents that the plan set: values as JSON by name

    def is_like(self, other: Ending) -> bool:
        """Return whether two endings are alike; for failed runs, only the failures are compared, not the states."""
        if self.kind != other.kind:
            return False
        if self.kind == SUCCEEDED:
            return next(iter(self.differences(other)), None) is None
        mine, others = ((_DECIMAL.sub("#", without_addresses(each.failure)), each.line) for each in (self, other))
        return mine == others

    def differences(self, other: Ending) -> Iterator[str]:
        """Yield texts that describe the differences of this ending's state from the state of another ending."""
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
    return without_addresses(a) == without_addresses(b) if isinstance(a, str) and isinstance(b, str) else a == b


class EndingSink:
    """Computes a run's ending from its records, and passes the records to a file, if there is one."""

    def __init__(self, file: McapSink | None = None) -> None:
        self._file: Sink = file or NullSink()
        self.attach, self.flush, self.close = self._file.attach, self._file.flush, self._file.close
        #: Lines of the tracebacks of failed tasks, by failure: for each task, (FILE, FILE:LINE), outermost line first.
        self._lines: dict[str, list[list[tuple[str, str]]]] = {}
        self._violated: dict[str, None] = {}  # violated properties, in the order of violations
        self._worlds: dict[str, FoldedWorld] = {}
        self.ending = Ending(DIED, "the process ended")  # replaced when the record of the run's end comes
        if file is not None:
            self.path = file.path  # recordings of projections are written next to this file

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Evaluate and forward a record."""
        self._file.write(topic, record, payload)
        if isinstance(record, Mutation | Keyframe):
            if not (isinstance(record, Mutation) and record.HasField("close_world")):  # closed worlds are compared, too
                apply(self._worlds, record)
        elif isinstance(record, Check):
            self._violated |= {record.property: None} if record.phase == Check.VIOLATED and record.only_record else {}
        elif isinstance(record, Fluent):
            if not record.source:
                self.ending.fluents[record.name] = record.after_json
        elif (failure := getattr(record, "failure", None)) is not None and failure.type and failure.frames:
            lines = [(frame.file, f"{frame.file}:{frame.line}") for frame in failure.frames]
            self._lines.setdefault(format_failure(failure), []).append(lines)
        if isinstance(record, Run) and record.phase == Run.FINISHED:
            self._finish(record)

    def _finish(self, record: Run) -> None:
        ending = self.ending
        ending.kind, ending.failure = VIOLATED if self._violated else SUCCEEDED, "; ".join(self._violated)
        if not record.succeeded:
            ending.failure = format_failure(record.failure)
            if passed := self._lines.get(ending.failure):
                plan = passed[-1][0][0]  # file of the plan
                ending.line = passed[0][-1][1]
                own = [at for lines in passed for file, at in reversed(lines) if file == plan]
                ending.plan_line = own[deciding([(plan, int(at.rpartition(":")[2])) for at in own])]
            ending.kind = DEADLOCK if record.failure.type == "DeadlockedBranches" else FAILED
        for name, world in self._worlds.items():
            for body, state in world.bodies.items():
                joints = {f"/{joint}": [position] for joint, position in state.joints.items()}
                pose = {"position": list(state.position), "orientation": list(state.orientation)}
                ending.bodies[f"{name}/{body}"] = pose | joints
            ending.held += [f"{name}: {carrier} holds {body}" for carrier, body in world.attachments]
