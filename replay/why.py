"""Why a plan failed: what failed and where in the plan, what was tried, what it rested on, and what had changed.

Everything here is read from the recording; nothing is guessed. What the robot was told (queries) is set beside what was
so then, and beside what has moved since.
"""

from __future__ import annotations

import builtins
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from recorder.records import Query
from replay.breakdown import breakdown
from replay.diff import Difference, difference
from replay.errors import NoSuchStep
from replay.failures import failures
from replay.plain import mentions, plain_arguments
from replay.source import Source
from replay.steps import final_of
from replay.summary import Summary, failed_threads, summary

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from recorder.records import Failure, Run
    from replay.breakdown import Breakdown
    from replay.failures import Attempt, Failures
    from replay.log import Log
    from replay.plain import Plain
    from replay.raised import Raised
    from replay.source import Line
    from replay.state import Attachment, Body, State, World

_MOST_ASKED: Final = 8  # queries that are told
_FIRST, _LAST = 5, 20  # of many attempts, those with what was so then
_NEAR: Final = 0.001  # m; what moved less has not moved since a query


@dataclass(frozen=True, slots=True)
class Thing:
    """A body that matters, at the moment that matters.

    Attributes:
        body: its state.
        held: how it is carried; None if it isn't.
        holds: what it carries.
        robot: whether it is the robot.
        distance: on the ground, from the robot's base, m; None for the robot itself, or without one.
        bearing: its direction from the robot's heading, rad, to the left; None as well.
    """

    body: Body
    held: Attachment | None
    holds: tuple[Attachment, ...]
    robot: bool
    distance: float | None
    bearing: float | None


@dataclass(frozen=True, slots=True)
class Try:
    """One time that something was tried.

    Attributes:
        task: the attempt.
        robot: the robot as it stood then; None if there was none. Of many attempts only the first and the last have it.
    """

    task: Attempt
    robot: Body | None


@dataclass(frozen=True, slots=True)
class Asked:
    """A query that the plan rested on.

    Attributes:
        query: its record.
        moved: what it was about and has moved between it and the failure.
        gone: what it was about and was removed since.
        world: the world that it was asked in, where that isn't the one of the failure; "" where it is.
    """

    query: Query
    moved: tuple[str, ...] = ()
    gone: tuple[str, ...] = ()
    world: str = ""

    @property
    def holds(self) -> bool:
        """Whether it is about what there was at the failure, and nothing of that has changed since."""
        return not (self.moved or self.gone or self.world)


@dataclass(frozen=True, slots=True)
class Since:
    """What has changed since something went well.

    Attributes:
        task: what went well.
        difference: of the states after it and before the failure.
    """

    task: Attempt
    difference: Difference


@dataclass(frozen=True, slots=True)
class Why:
    """The explanation of a failure.

    Attributes:
        run: how the whole run ended.
        step: the moment that is explained: that in which it failed.
        failure: what the plan failed with, or the task; None if nothing failed.
        thread: name of the plan's own thread that failed with it while the plan went on; "" if the plan did.
        raised: the exceptions that led to the plan's failure, causes first, with the plan's lines.
        task: the task in which it began; None if the plan's own code did it.
        way: the plan's lines that led to that task, outermost first.
        world: the world that it was about; None if none was open.
        is_default: whether that is the one that is meant where no world is named.
        things: the robot, and the bodies that it was about.
        absent: names of such bodies that weren't there any more.
        tries: all attempts of the same with the same objects, this one last.
        others: how many other tasks failed before.
        asked: the queries that it rested on, in their order.
        earlier: how many more queries were about the same.
        same: since the same kind of task went well for the last time; None if it never did.
        last: since anything went well for the last time.
        running: the innermost tasks that have not ended, of a recording that was cut.
        threads: the records of other threads of the plan's own that failed.
    """

    run: Summary
    step: int
    failure: Failure | None
    thread: str = ""
    raised: tuple[Raised, ...] = ()
    task: Attempt | None = None
    way: tuple[Line, ...] = ()
    world: World | None = None
    is_default: bool = True
    things: tuple[Thing, ...] = ()
    absent: tuple[str, ...] = ()
    tries: tuple[Try, ...] = ()
    others: int = 0
    asked: tuple[Asked, ...] = ()
    earlier: int = 0
    same: Since | None = None
    last: Since | None = None
    running: tuple[Attempt, ...] = ()
    threads: tuple[Run, ...] = ()

    @property
    def is_of_python(self) -> bool:
        """Whether the plan's code itself is wrong, rather than that something in the world was not as it should be."""
        return self.task is None and self.failure is not None and hasattr(builtins, self.failure.type)

    @property
    def warning(self) -> Query | None:
        """The last query that said no, and still was so: nothing that it was about has moved since."""
        told = (asked.query for asked in reversed(self.asked) if asked.holds)
        return next((query for query in told if query.answer_json == "false"), None)


def why(log: Log, step: int | str | None = None) -> Why:
    """Explains a failure.

    Args:
        log: the recording.
        step: one of a task that failed, or the first after it did; by default that of
            :func:`replay.breakdown.breakdown`.

    Raises:
        NoSuchStep: there is no such step, or nothing failed until then.
    """
    found = failures(log)
    run = summary(log)
    if step is not None:
        return _of_task(log, run, _chosen(log, found, log.step(step)))
    broken = breakdown(log, found)
    running = tuple(task for task in found.running if not any(part in found.running for part in task.parts))
    if broken is None:
        return Why(run, final_of(log), None, running=running)
    if broken.task is None:
        told = _of_plan(log, run, failures(log, broken.step) if broken.thread else found, broken)
    else:
        told = _of_task(log, run, broken.task, broken, running)
    return replace(told, threads=tuple(each for each in failed_threads(log) if each.failure != broken.failure))


def _chosen(log: Log, found: Failures, step: int) -> Attempt:
    """The failed task that a step is part of, or that ended last until then."""
    record = log[step]
    until = [task for task in found.origins if task.finished is not None and task.finished.seq <= step]
    of_step = [task for task in found.origins if any(outer.started.task == record.task for outer in task.around())]
    if record.task and of_step:
        return of_step[-1]
    if not until:
        raise NoSuchStep(step, len(log), "no task failed there, or before")
    return until[-1]


def _of_task(
    log: Log, run: Summary, task: Attempt, broken: Breakdown | None = None, running: tuple[Attempt, ...] = ()
) -> Why:
    source, motion = Source(log), task.motion
    began, ended = motion.started.seq, task.end
    before = failures(log, ended + 1)
    objects = _objects(motion.parameters)
    alike = [other for other in before.origins if _is_alike(log, other.motion, motion, objects)]
    previous = next(
        (other for other in reversed(alike) if other.motion is not motion and other.motion.started.seq < began), None
    )
    same = before.successes.get((motion.started.kind, motion.started.name))
    window = max((each.end for each in (previous, same) if each is not None), default=0)
    asked, earlier = _asked(log, window, ended, objects, _ids(task))
    state = log.state_at(ended)
    world = _world(state, objects, asked)
    return Why(
        run,
        ended,
        (broken.failure if broken is not None else None) or task.failure,
        broken.thread if broken is not None else "",
        broken.chain if broken is not None else (),
        task,
        next(filter(None, (source.way(each.started) for each in task.around())), ()),
        world,
        world is None or world is state.world(),
        tuple(_things(world, [*_of_world(objects, world), *_named(world, task)])),
        tuple(name for name in _of_world(objects, world) if world is not None and name not in world.bodies),
        tuple(_tries(log, alike, world)),
        sum(1 for other in before.origins if other not in alike),
        tuple(_with_changes(log, query, world) for query in asked),
        earlier,
        _since(log, same, state),
        _since(log, before.last_success, state),
        running,
    )


def _of_plan(log: Log, run: Summary, found: Failures, broken: Breakdown) -> Why:
    """Of a failure that the plan's own code raised, not a task."""
    state = log.state_at(broken.step)
    last = found.last_success
    window = last.started.seq if last is not None else 0
    asked, earlier = _asked(log, window, broken.step if broken.thread else len(log), (), ())
    objects = list(dict.fromkeys(each for query in asked for each in _objects(plain_arguments(query.arguments))))
    world = _world(state, objects, asked)
    return Why(
        run,
        broken.step,
        broken.failure,
        broken.thread,
        broken.chain,
        world=world,
        is_default=world is None or world is state.world(),
        things=tuple(_things(world, _of_world(objects, world))),
        others=len(found.origins),
        asked=tuple(_with_changes(log, query, world) for query in asked),
        earlier=earlier,
        last=_since(log, last, state),
    )


# --- what was tried --------------------------------------------------------------------------------------------------


def _is_alike(log: Log, task: Attempt, wanted: Attempt, objects: Iterable[tuple[str, str]]) -> bool:
    """Whether it is the same that was tried, with one of the same bodies: those of a later world are others."""
    if (task.started.kind, task.started.name) != (wanted.started.kind, wanted.started.name):
        return False
    told = set(_objects(task.parameters))
    now, then = wanted.started.seq, task.started.seq
    common = told.intersection(objects)
    return not objects or not told or any(log.life_at(world, now) == log.life_at(world, then) for _, world in common)


def _ids(task: Attempt) -> set[int]:
    return {each.started.task for each in task.around()}


def _tries(log: Log, tasks: Sequence[Attempt], world: World | None) -> Iterator[Try]:
    for number, task in enumerate(tasks):
        robot = None
        if world is not None and (number < _FIRST or number >= len(tasks) - _LAST):
            then = log.state_at(max(task.motion.started.seq - 1, 0)).worlds.get(world.name)
            robot = then.bodies.get(then.robot) if then is not None else None
        yield Try(task, robot)


def _objects(parameters: Plain) -> list[tuple[str, str]]:
    """Names of the bodies in values, with their worlds."""
    if isinstance(parameters, dict):
        if set(parameters) == {"object", "world"}:
            return [(str(parameters["object"]), str(parameters["world"]))]
        return [found for value in parameters.values() for found in _objects(value)]
    if isinstance(parameters, list):
        return [found for value in parameters for found in _objects(value)]
    return []


# --- what it rested on -----------------------------------------------------------------------------------------------


def _asked(
    log: Log, start: int, stop: int, objects: Iterable[tuple[str, str]], tasks: Iterable[int]
) -> tuple[list[Query], int]:
    """The last queries about some bodies, or of some tasks, each question once; and how many more there are."""
    latest: dict[tuple[object, ...], Query] = {}
    names, ids = {name for name, _ in objects}, set(tasks)
    for query in log.records(Query, start, stop):
        if isinstance(query, Query) and (
            not names or query.task in ids or any(mentions(query, name) for name in names)
        ):
            question = (query.name, query.world, *((argument.name, argument.json) for argument in query.arguments))
            latest.pop(question, None)
            latest[question] = query
    found = list(latest.values())
    return found[-_MOST_ASKED:], max(len(found) - _MOST_ASKED, 0)


def _with_changes(log: Log, query: Query, world: World | None) -> Asked:
    """A query with what became of the things that it was about, until the failure in a world."""
    then = log.state_at(query.seq).worlds.get(query.world)
    if then is None or world is None:
        return Asked(query)
    if then.title != world.title:
        return Asked(query, world=then.title)
    moved, gone = [], []
    for name, _ in dict.fromkeys(_objects(plain_arguments(query.arguments))):
        before, after = then.bodies.get(name), world.bodies.get(name)
        if before is None:
            continue
        if after is None:
            gone.append(name)
        elif math.dist(before.position, after.position) > _NEAR:
            moved.append(name)
    return Asked(query, tuple(moved), tuple(gone))


# --- what was so -----------------------------------------------------------------------------------------------------


def _world(state: State, objects: Iterable[tuple[str, str]], asked: Iterable[Query]) -> World | None:
    """The world that it was about."""
    opened = {name: world for name, world in state.worlds.items() if world.open}
    for name in (*(world for _, world in objects), *(query.world for query in asked)):
        if name in opened:
            return opened[name]
    return max(opened.values(), key=lambda world: bool(world.robot), default=None)


def _of_world(objects: Iterable[tuple[str, str]], world: World | None) -> list[str]:
    """The names of those bodies that are of a world."""
    return [name for name, place in objects if world is not None and place == world.name]


def _things(world: World | None, names: Iterable[str]) -> Iterator[Thing]:
    if world is None:
        return
    robot = world.bodies.get(world.robot)
    for name in dict.fromkeys((world.robot, *names)):
        body = world.bodies.get(name)
        if body is not None:
            distance = bearing = None
            if robot is not None and body is not robot:
                across, along = body.position[0] - robot.position[0], body.position[1] - robot.position[1]
                distance = math.hypot(across, along)
                bearing = math.remainder(math.atan2(along, across) - heading(robot), math.tau)
            yield Thing(body, world.carrier(name), tuple(world.carried(name)), body is robot, distance, bearing)


def _named(world: World | None, task: Attempt) -> Iterator[str]:
    """The bodies that a failure names in its data."""
    data = plain_arguments(task.failure.data) if task.failure is not None else {}
    for value in data.values():
        for name in value if isinstance(value, list) else [value]:
            body = world.bodies.get(name) if world is not None and isinstance(name, str) else None
            if body is not None and not body.fixed_base:  # furniture is where it always is
                yield body.name


def heading(body: Body) -> float:
    """Where a body faces on the ground, rad from the world's x axis.

    Args:
        body: its state.
    """
    x, y, z, w = body.orientation
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _since(log: Log, task: Attempt | None, now: State) -> Since | None:
    if task is None or task.finished is None:
        return None
    return Since(task, difference(log.state_at(min(task.finished.seq, now.step)), now))
