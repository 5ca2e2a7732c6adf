"""An explanation as text: what went wrong in a few sentences, then one section for each further question."""

from __future__ import annotations

import builtins
import math
import shlex
from typing import TYPE_CHECKING, Final

from recorder.records import format_failure
from replay.cli import diff
from replay.cli.why_advice import asked_again, commands
from replay.explain import wording
from replay.explain.explanation import heading

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Failure
    from replay.explain.explanation import Attempt, ChangesSince, InvolvedBody, Why
    from replay.explain.failed_tasks import TaskExecution
    from replay.explain.source import Line

_FIRST, _LAST = 2, 5  # attempts that are listed one by one
_MAX_LINES: Final = 12  # of a difference


def lines(found: Why, path: str) -> Iterator[str]:
    """Yield the explanation as text; ``path`` is the recording's, for commands."""
    yield from _headline(found)
    yield from _section("Unfinished when the recording ended", _unfinished(found))
    if found.failure is None:
        return
    yield from _section("Where in the plan", _where(found))
    yield from _section("What failed", _failed(found))
    yield from _section(f"State{_in_world(found)} at step {found.step}", _bodies(found))
    yield from _section("Attempts", _attempts(found))
    yield from _section("Queries that the plan relied on", _queries(found))
    yield from _section("Changes since the last success", _changes(found))
    yield from _section("Look closer", commands(found, shlex.quote(path)))


def _section(title: str, body: Iterator[str]) -> Iterator[str]:
    text = list(body)
    if text:
        yield ""
        yield title
        yield from (f"  {line}" for line in text)


def _headline(found: Why) -> Iterator[str]:
    run, name = found.run, found.run.plan or "the plan"
    if run.outcome == "failed":
        message = run.failure
        if found.exceptions and found.failure is not None and _is_self_explanatory(found.failure):
            message = found.failure.message
        yield f"{name} failed after {run.seconds:.1f} s: {wording.one_line(message)}"
    elif run.outcome == "succeeded":
        yield f"{name} succeeded{_though(found)}"
    else:
        ended = "is still running" if run.outcome == "running" else f"was cut off at step {run.records - 1}"
        yield f"{name} {ended}." + ("" if found.failure else " Until then nothing failed.")
    if found.task is not None:
        yield from _summary(found, found.task)
    warning = found.warning
    if warning is not None and not found.is_python_error:
        yield f"The plan had been warned: {asked_again(warning)} was answered no at step {warning.seq}."


def _though(found: Why) -> str:
    if found.thread and found.failure is not None:
        return f", although its thread {found.thread} failed: {wording.one_line(format_failure(found.failure))}"
    return ", although a task failed." if found.failure is not None else "."


def _is_self_explanatory(failure: Failure) -> bool:
    """Return whether a message needs no type before it; messages of Python's own errors do."""
    return " " in failure.message and not hasattr(builtins, failure.type)


def _summary(found: Why, task: TaskExecution) -> Iterator[str]:
    motion = task.motion
    error = wording.one_line(task.error[1] or task.error[0]) if task.error else ""
    if len(found.attempts) > 1:
        name, times = motion.started.name, len(found.attempts)
        if found.since_same_success is None:
            yield f"{name} was attempted {times} times and failed each time."
        else:
            yield f"{name} failed {times} times; it last succeeded at step {found.since_same_success.task.end}."
        yield f"The last attempt, {_call(motion)}, failed at step {task.end}: {error}"
        return
    lead = "The cause:" if found.exceptions else "Before that,"
    yield f"{lead} {_call(motion)} failed at step {task.end}: {error}"


def _call(task: TaskExecution) -> str:
    return wording.task(task.started.kind, task.started.name, task.parameters)


def _unfinished(found: Why) -> Iterator[str]:
    for task in found.unfinished:
        yield " in ".join(_call(each) for each in task.around()) + f"  [since step {task.started.seq}]"


def _where(found: Why) -> Iterator[str]:
    shown: set[tuple[str, int]] = set()
    for line in () if _exceptions_lead_to_task(found) else found.call_stack:
        shown.add((line.file, line.number))
        yield from _line(line)
    for error in found.exceptions:
        fresh = [line for line in error.lines if (line.file, line.number) not in shown]
        if shown and fresh:
            yield f"which became {error.type}:"
        for line in fresh:
            shown.add((line.file, line.number))
            yield from _line(line)


def _exceptions_lead_to_task(found: Why) -> bool:
    """Return whether the lines of the exceptions lead to the task; those of a failed block end where the block does."""
    lines = [line for error in found.exceptions for line in error.lines]
    return any(
        line.file == last.file and last.function in ("", line.function)
        for last in found.call_stack[-1:]
        for line in lines
    )


def _line(line: Line) -> Iterator[str]:
    yield f"{wording.path(line.file)}:{line.number}" + (f" in {line.function}" if line.function else "")
    if line.text:
        yield f"    {line.text}"


def _failed(found: Why) -> Iterator[str]:
    yield from _tasks(found)
    for record in found.failed_threads:
        failure = wording.one_line(format_failure(record.failure))
        yield f"also failed: thread {record.thread}, at step {record.seq}: {failure}"


def _tasks(found: Why) -> Iterator[str]:
    if found.task is None:
        if found.failure is not None:
            yield f"no task: the plan's own code raised{f', in thread {found.thread}' if found.thread else ''}"
            yield from (f"  {line}" for line in format_failure(found.failure).splitlines())
        return
    path = list(found.task.around())
    path.reverse()
    for depth, task in enumerate(path):
        if task.finished is None and task is not found.task:
            state = "not finished"
        else:
            took = wording.seconds(task.finished.duration_ns) if task.finished is not None else ""
            state = f"failed after {took}" if task.failure is not None else f"went on, {took}"
        yield f"{'  ' * depth}{_call(task)}  [steps {task.started.seq}-{task.end}, {state}]"
    if found.task.failure is not None:
        yield from (f"{'  ' * len(path)}{line}" for line in format_failure(found.task.failure).splitlines())
    attempted = {attempt.task for attempt in found.attempts}  # in a section of their own
    siblings = [
        part
        for part in found.task.outermost.parts
        if part.failure is not None and part not in path and part.origin not in attempted
    ]
    for part in siblings[:_LAST]:
        yield f"also failed: {_call(part)}: {wording.one_line(part.error[1]) if part.error else ''}"


def _in_world(found: Why) -> str:
    """Return which world it is, unless it is the default one."""
    world = found.world
    return f" in {world.title}" if world is not None and not (found.is_default and world.lifetime == 1) else ""


def _bodies(found: Why) -> Iterator[str]:
    yield from (_involved(involved) for involved in found.bodies)
    yield from (f"{name} had been removed" for name in found.removed)


def _involved(involved: InvolvedBody) -> str:
    body = involved.body
    text = f"{body.name} at {wording.vector(body.position)}"
    if involved.is_robot:
        text += f", facing {_degrees(heading(body))}"
        text += (
            f", holding {wording.names([held.body for held in involved.holds])}"
            if involved.holds
            else ", holding nothing"
        )
    elif involved.distance is not None and involved.bearing is not None:
        side = math.degrees(involved.bearing)
        turn = (
            "straight ahead" if abs(side) < 1 else f"{abs(side):.0f} degrees to the {'left' if side > 0 else 'right'}"
        )
        text += f", {involved.distance:.2f} m from the robot on the ground, {turn}"
    return text + (f", held by {involved.held.carrier}" if involved.held else "")


def _degrees(angle: float) -> str:
    return f"{round(math.degrees(angle)) or 0} degrees"


def _attempts(found: Why) -> Iterator[str]:
    if found.other_failures:
        tasks = "tasks" if found.other_failures > 1 else "task"
        yield f"{found.other_failures} other {tasks} failed before (see `pycram-replay tree`)"
    if len(found.attempts) < 2:
        return
    given = [attempt.task.motion.parameters for attempt in found.attempts]
    varying = [key for key in given[-1] if any(other.get(key) != given[-1][key] for other in given)]
    places = [_place(attempt) for attempt in found.attempts]
    differ = len({place for place in places if place}) > 1
    groups: list[tuple[str, str, list[int]]] = []  # parameters, error and steps of equal attempts in a row
    for attempt, place in zip(found.attempts, places, strict=True):
        how = [f"{key}={wording.value(attempt.task.motion.parameters.get(key))}" for key in varying]
        how += [place] if place and differ else []
        error = wording.one_line(attempt.task.error[1]) if attempt.task.error else ""
        if not groups or groups[-1][:2] != (", ".join(how), error):
            groups.append((", ".join(how), error, []))
        groups[-1][2].append(attempt.task.motion.started.seq)
    left_out = len(groups) - _FIRST - _LAST
    for number, (parameters, error, steps) in enumerate(groups):
        if left_out > 1 and number == _FIRST:
            yield f"... {left_out} more ..."
        if left_out <= 1 or not _FIRST <= number < _FIRST + left_out:
            many = f"steps {steps[0]} to {steps[-1]}, {len(steps)} times" if len(steps) > 1 else f"step {steps[0]}"
            yield f"{many}: {parameters}" if parameters else f"{many}:"
            yield f"    {error}"


def _place(attempt: Attempt) -> str:
    robot = attempt.robot
    return f"{robot.name} at {wording.vector(robot.position[:2])} facing {_degrees(heading(robot))}" if robot else ""


def _queries(found: Why) -> Iterator[str]:
    if found.earlier_queries:
        yield f"... {found.earlier_queries} earlier ones ..."
    for relevant in found.queries:
        query = relevant.query
        reasons = wording.reasons(query)
        yield f"step {query.seq}: {wording.question(query)}"
        yield f"    {wording.answer(query)}" + (f": {reasons}" if reasons else "")
        if relevant.world:
            yield f"    asked in another world: {relevant.world}"
        if relevant.moved:
            yield f"    since then {wording.names(relevant.moved)} moved"
        if relevant.removed:
            were = "was" if len(relevant.removed) == 1 else "were"
            yield f"    since then {wording.names(relevant.removed)} {were} removed"


def _changes(found: Why) -> Iterator[str]:
    if found.task is not None:
        started = found.task.motion.started
        if found.since_same_success is None:
            yield f"No {wording.task(started.kind, started.name, {})} succeeded before."
        else:
            yield from _since(found.since_same_success)
    if found.since_last_success is not None and (
        found.since_same_success is None or found.since_same_success.task is not found.since_last_success.task
    ):
        yield from _since(found.since_last_success)


def _since(since: ChangesSince) -> Iterator[str]:
    task = since.task
    changes = list(diff.lines(since.difference)) if since.difference.notable or since.difference.added else []
    name = f"{_call(task)} succeeded at step {task.end}"
    if not changes:
        yield f"{name}; since then nothing in the world has changed."
        return
    yield f"{name}; since then:"
    yield from (f"  {line}" for line in changes[:_MAX_LINES])
    if len(changes) > _MAX_LINES:
        yield f"  ... {len(changes) - _MAX_LINES} more lines; `diff` lists all"
