"""An explanation for people: what went wrong in plain words, then one section for each question that comes next."""

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
    from replay.explain.explanation import Since, Thing, Try, Why
    from replay.explain.failed_tasks import Attempt
    from replay.explain.source import Line

_FIRST, _LAST = 2, 5  # so many attempts are told one by one
_MOST: Final = 12  # lines of a difference


def lines(found: Why, path: str) -> Iterator[str]:
    """The explanation, for people.

    Args:
        found: the explanation.
        path: of the recording, for commands to go on with.
    """
    yield from _headline(found)
    yield from _section("Not finished when the recording ended", _running(found))
    if found.failure is None:
        return
    yield from _section("Where in the plan", _where(found))
    yield from _section("What failed", _what(found))
    yield from _section(f"How things were{_in_world(found)}, at step {found.step}", _things(found))
    yield from _section("What was tried", _tried(found))
    yield from _section("What the robot asked, and was told", _asked(found))
    yield from _section("What has changed since the last success", _changed(found))
    yield from _section("Look closer", commands(found, shlex.quote(path)))


def _section(title: str, body: Iterator[str]) -> Iterator[str]:
    told = list(body)
    if told:
        yield ""
        yield title
        yield from (f"  {line}" for line in told)


def _headline(found: Why) -> Iterator[str]:
    run, name = found.run, found.run.plan or "the plan"
    if run.outcome == "failed":
        message = run.failure
        if found.raised and found.failure is not None and _says_it(found.failure):
            message = found.failure.message
        yield f"{name} failed after {run.seconds:.1f} s: {wording.one_line(message)}"
    elif run.outcome == "succeeded":
        yield f"{name} succeeded{_though(found)}"
    else:
        ended = "is still running" if run.outcome == "running" else f"was cut off at step {run.records - 1}"
        yield f"{name} {ended}." + ("" if found.failure else " Until then nothing failed.")
    if found.task is not None:
        yield from _first_words(found, found.task)
    warning = found.warning
    if warning is not None and not found.is_of_python:
        yield f"The robot had been told: {asked_again(warning)} said no at step {warning.seq}."


def _though(found: Why) -> str:
    if found.thread and found.failure is not None:
        return f", though its thread {found.thread} failed: {wording.one_line(format_failure(found.failure))}"
    return ", though something failed on its way." if found.failure is not None else "."


def _says_it(failure: Failure) -> bool:
    """Whether a message says in words what was wrong; those of Python's own errors need the error's name too."""
    return " " in failure.message and not hasattr(builtins, failure.type)


def _first_words(found: Why, task: Attempt) -> Iterator[str]:
    motion = task.motion
    told = wording.one_line(task.error[1] or task.error[0]) if task.error else ""
    if len(found.tries) > 1:
        name, times = motion.started.name, len(found.tries)
        if found.same is None:
            yield f"{name} was tried {times} times, and failed each time."
        else:
            yield f"{name} failed {times} times; it last succeeded at step {found.same.task.end}."
        yield f"The last, {_call(motion)}, ended at step {task.end}: {told}"
        return
    lead = "It began when" if found.raised else "Before that,"
    yield f"{lead} {_call(motion)} failed at step {task.end}: {told}"


def _call(task: Attempt) -> str:
    return wording.task(task.started.kind, task.started.name, task.parameters)


def _running(found: Why) -> Iterator[str]:
    for task in found.running:
        yield " in ".join(_call(each) for each in task.around()) + f"  [since step {task.started.seq}]"


def _where(found: Why) -> Iterator[str]:
    shown: set[tuple[str, int]] = set()
    for line in () if _leads_there(found) else found.way:
        shown.add((line.file, line.number))
        yield from _line(line)
    for error in found.raised:
        fresh = [line for line in error.lines if (line.file, line.number) not in shown]
        if shown and fresh:
            yield f"which became {error.type}:"
        for line in fresh:
            shown.add((line.file, line.number))
            yield from _line(line)


def _leads_there(found: Why) -> bool:
    """Whether the lines of the exceptions lead to the task; those of a failed block end where the block does."""
    lines = [line for error in found.raised for line in error.lines]
    return any(
        line.file == last.file and last.function in ("", line.function) for last in found.way[-1:] for line in lines
    )


def _line(line: Line) -> Iterator[str]:
    yield f"{wording.path(line.file)}:{line.number}" + (f" in {line.function}" if line.function else "")
    if line.text:
        yield f"    {line.text}"


def _what(found: Why) -> Iterator[str]:
    yield from _tasks(found)
    for each in found.threads:
        yield f"also failed: thread {each.thread}, at step {each.seq}: {wording.one_line(format_failure(each.failure))}"


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
    told = {each.task for each in found.tries}  # in a section of their own
    siblings = [
        part
        for part in found.task.outermost.parts
        if part.failure is not None and part not in path and part.origin not in told
    ]
    for part in siblings[:_LAST]:
        yield f"also failed: {_call(part)}: {wording.one_line(part.error[1]) if part.error else ''}"


def _in_world(found: Why) -> str:
    """Which world it is, where that isn't plain."""
    world = found.world
    return f" in {world.title}" if world is not None and not (found.is_default and world.lifetime == 1) else ""


def _things(found: Why) -> Iterator[str]:
    yield from (_thing(thing) for thing in found.things)
    yield from (f"{name} isn't there any more" for name in found.absent)


def _thing(thing: Thing) -> str:
    body = thing.body
    told = f"{body.name} at {wording.vector(body.position)}"
    if thing.robot:
        told += f", facing {_degrees(heading(body))}"
        told += (
            f", holding {wording.names([held.body for held in thing.holds])}" if thing.holds else ", holding nothing"
        )
    elif thing.distance is not None and thing.bearing is not None:
        side = math.degrees(thing.bearing)
        turn = (
            "straight ahead" if abs(side) < 1 else f"{abs(side):.0f} degrees to the {'left' if side > 0 else 'right'}"
        )
        told += f", {thing.distance:.2f} m from the robot on the ground, {turn}"
    return told + (f", held by {thing.held.carrier}" if thing.held else "")


def _degrees(angle: float) -> str:
    return f"{round(math.degrees(angle)) or 0} degrees"


def _tried(found: Why) -> Iterator[str]:
    if found.others:
        yield f"{found.others} other {'tasks' if found.others > 1 else 'task'} failed before (`pycram-replay tree`)"
    if len(found.tries) < 2:
        return
    given = [each.task.motion.parameters for each in found.tries]
    varying = [key for key in given[-1] if any(other.get(key) != given[-1][key] for other in given)]
    places = [_place(each) for each in found.tries]
    differ = len({place for place in places if place}) > 1
    told: list[tuple[str, str, list[int]]] = []  # how, what came of it, and at which steps one after the other
    for each, place in zip(found.tries, places, strict=True):
        how = [f"{key}={wording.value(each.task.motion.parameters.get(key))}" for key in varying]
        how += [place] if place and differ else []
        error = wording.one_line(each.task.error[1]) if each.task.error else ""
        if not told or told[-1][:2] != (", ".join(how), error):
            told.append((", ".join(how), error, []))
        told[-1][2].append(each.task.motion.started.seq)
    left_out = len(told) - _FIRST - _LAST
    for number, (how_told, error, steps) in enumerate(told):
        if left_out > 1 and number == _FIRST:
            yield f"... {left_out} more ..."
        if left_out <= 1 or not _FIRST <= number < _FIRST + left_out:
            many = f"steps {steps[0]} to {steps[-1]}, {len(steps)} times" if len(steps) > 1 else f"step {steps[0]}"
            yield f"{many}: {how_told}" if how_told else f"{many}:"
            yield f"    {error}"


def _place(each: Try) -> str:
    if each.robot is None:
        return ""
    return f"{each.robot.name} at {wording.vector(each.robot.position[:2])} facing {_degrees(heading(each.robot))}"


def _asked(found: Why) -> Iterator[str]:
    if found.earlier:
        yield f"... {found.earlier} more before ..."
    for asked in found.asked:
        query = asked.query
        told = wording.reasons(query)
        yield f"step {query.seq}: {wording.question(query)}"
        yield f"    {wording.answer(query)}" + (f": {told}" if told else "")
        if asked.world:
            yield f"    asked in another world: {asked.world}"
        if asked.moved:
            yield f"    since then {wording.names(asked.moved)} moved"
        if asked.gone:
            yield f"    since then {wording.names(asked.gone)} {'was' if len(asked.gone) == 1 else 'were'} removed"


def _changed(found: Why) -> Iterator[str]:
    if found.task is not None:
        started = found.task.motion.started
        if found.same is None:
            yield f"No {wording.task(started.kind, started.name, {})} succeeded before."
        else:
            yield from _since(found.same)
    if found.last is not None and (found.same is None or found.same.task is not found.last.task):
        yield from _since(found.last)


def _since(since: Since) -> Iterator[str]:
    task = since.task
    told = list(diff.lines(since.difference)) if since.difference.notable or since.difference.came else []
    name = f"{_call(task)} succeeded at step {task.end}"
    if not told:
        yield f"{name}; since then nothing in the world has changed."
        return
    yield f"{name}; since then:"
    yield from (f"  {line}" for line in told[:_MOST])
    if len(told) > _MOST:
        yield f"  ... {len(told) - _MOST} more lines; `diff` tells all"
