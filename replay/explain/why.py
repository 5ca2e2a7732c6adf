"""Why a plan failed: what failed and where in the plan, what was tried, what it rested on, and what had changed.

Everything here is read from the recording; nothing is guessed. What the robot was told (queries) is set beside what was
so then, and beside what has moved since.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from recorder.records import Query
from replay.errors import NoSuchStep
from replay.explain.explanation import Asked, Since, Thing, Try, Why, heading
from replay.explain.failed_tasks import failures
from replay.explain.root_cause import root_cause
from replay.explain.source import Source
from replay.explain.step_names import step_of
from replay.explain.summary import failed_threads, final_of, summary
from replay.state.diff import difference
from replay.state.fold import state_at
from replay.state.json_data import arguments_data, mentions

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from replay.explain.failed_tasks import Attempt, Failures
    from replay.explain.root_cause import RootCause
    from replay.explain.summary import Summary
    from replay.file.log import Log
    from replay.state.json_data import Plain
    from replay.state.state import State, World

_MOST_ASKED: Final = 8  # queries that are told
_FIRST, _LAST = 5, 20  # of many attempts, those with what was so then
_NEAR: Final = 0.001  # m; what moved less has not moved since a query


def why(log: Log, step: int | str | None = None) -> Why:
    """Explains a failure.

    Args:
        log: the recording.
        step: one of a task that failed, or the first after it did; by default that of
            :func:`replay.explain.root_cause.root_cause`.

    Raises:
        NoSuchStep: there is no such step, or nothing failed until then.
    """
    found = failures(log)
    run = summary(log)
    if step is not None:
        return _of_task(log, run, _chosen(log, found, step_of(log, step)))
    broken = root_cause(log, found)
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
    log: Log, run: Summary, task: Attempt, broken: RootCause | None = None, running: tuple[Attempt, ...] = ()
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
    state = state_at(log, ended)
    world = _world(state, objects, asked)
    return Why(
        run,
        ended,
        (broken.failure if broken is not None else None) or task.failure,
        thread=broken.thread if broken is not None else "",
        raised=broken.chain if broken is not None else (),
        task=task,
        way=next(filter(None, (source.way(each.started) for each in task.around())), ()),
        world=world,
        is_default=world is None or world is state.world(),
        things=tuple(_things(world, [*_of_world(objects, world), *_named(world, task)])),
        absent=tuple(name for name in _of_world(objects, world) if world is not None and name not in world.bodies),
        tries=tuple(_tries(log, alike, world)),
        others=sum(1 for other in before.origins if other not in alike),
        asked=tuple(_with_changes(log, query, world) for query in asked),
        earlier=earlier,
        same=_since(log, same, state),
        last=_since(log, before.last_success, state),
        running=running,
    )


def _of_plan(log: Log, run: Summary, found: Failures, broken: RootCause) -> Why:
    """Of a failure that the plan's own code raised, not a task."""
    state = state_at(log, broken.step)
    last = found.last_success
    window = last.started.seq if last is not None else 0
    asked, earlier = _asked(log, window, broken.step if broken.thread else len(log), (), ())
    objects = list(dict.fromkeys(each for query in asked for each in _objects(arguments_data(query.arguments))))
    world = _world(state, objects, asked)
    return Why(
        run,
        broken.step,
        broken.failure,
        thread=broken.thread,
        raised=broken.chain,
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
    return (
        not objects
        or not told
        or any(log.lifetime_at(world, now) == log.lifetime_at(world, then) for _, world in common)
    )


def _ids(task: Attempt) -> set[int]:
    return {each.started.task for each in task.around()}


def _tries(log: Log, tasks: Sequence[Attempt], world: World | None) -> Iterator[Try]:
    for number, task in enumerate(tasks):
        robot = None
        if world is not None and (number < _FIRST or number >= len(tasks) - _LAST):
            then = state_at(log, max(task.motion.started.seq - 1, 0)).worlds.get(world.name)
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
    then = state_at(log, query.seq).worlds.get(query.world)
    if then is None or world is None:
        return Asked(query)
    if then.title != world.title:
        return Asked(query, world=then.title)
    moved, gone = [], []
    for name, _ in dict.fromkeys(_objects(arguments_data(query.arguments))):
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
    data = arguments_data(task.failure.data) if task.failure is not None else {}
    for value in data.values():
        for name in value if isinstance(value, list) else [value]:
            body = world.bodies.get(name) if world is not None and isinstance(name, str) else None
            if body is not None and not body.fixed_base:  # furniture is where it always is
                yield body.name


def _since(log: Log, task: Attempt | None, now: State) -> Since | None:
    if task is None or task.finished is None:
        return None
    return Since(task, difference(state_at(log, min(task.finished.seq, now.step)), now))
