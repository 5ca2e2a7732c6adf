"""Names of steps: numbers, ``last``, ``failure``, ``12.5s`` of simulated time, ``task:pick-up#2@end``."""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from typing import Final

from recorder.errors import suggestion
from recorder.records import STEPS_PER_SECOND, Keyframe, Mutation, Task
from recorder.tasks import Node, Tree
from replay.errors import NoSuchStep
from replay.file.lifetimes import Lifetime, closes_world
from replay.file.record_reader import RecordReader

HINT: Final = "a number (negative: from the end), last, failure, a simulated time (12.5s), or task:PATH@start or @end"
_TASK: Final = re.compile(r"task:(?P<path>.+?)(?:#(?P<which>-?\d+))?@(?P<end>start|end)")


def step_of(log: RecordReader, name: int | str) -> int:
    """Return the number of a step; raise NoSuchStep if there is no such step.

    A name is a number, ``last``, ``failure`` (the step that ``why`` explains), a simulated time such as ``12.5s``, or a
    task (:func:`task_step`). Negative numbers count from the end. A time means the last step before a world's clock
    passes the time.
    """
    text = str(name).strip()
    if text == "last":
        return len(log) - 1
    if text == "failure":
        from replay.history.tasks import root_cause  # noqa: PLC0415  slow to import

        cause = root_cause(log)
        if cause is None:
            raise NoSuchStep("failure", len(log), "nothing failed")
        return cause.step
    if text.startswith("task:"):
        return task_step(log, text)
    moment = moment_of(text)
    if moment is not None:
        return _at_time(log, moment, text)
    try:
        number = int(text)
    except ValueError:
        raise NoSuchStep(repr(text), len(log), f"a step is {HINT}") from None
    step = number + len(log) if number < 0 else number
    if not 0 <= step < len(log):
        raise NoSuchStep(number, len(log))
    return step


def moment_of(name: int | str) -> float | None:
    """Return the simulated time in the name of a step in s; None for other names."""
    text = str(name).strip()
    try:
        moment = float(text[:-1]) if text.endswith("s") else math.nan
    except ValueError:
        return None
    return moment if math.isfinite(moment) else None


def task_step(log: RecordReader, text: str) -> int:
    """Return the step of ``task:PATH@start`` or ``task:PATH@end``: the start or the end of a task.

    PATH is the id of the task, or names of outer tasks and the task, such as ``par/moving``. Names of outer tasks are
    optional. If several tasks match, ``task:pick-up#2@end`` is the end of the second task, and ``#-1`` means the last
    task. By default, the first matching task is used. If no task matches or has ended, raise NoSuchStep.
    """
    match = _TASK.fullmatch(text)
    if match is None:
        raise NoSuchStep(repr(text), len(log), "the step of a task is task:PATH@start or task:PATH@end")
    number = int(match["which"] or 1)
    path = match["path"]
    tree, tasks = Tree(limit=0), list[Node]()  # only unfinished tasks stay in memory
    for record in log.records(Task):
        task = tree.apply(record)
        if record.phase == Task.STARTED and (is_called(task, path) or path == str(task.id)):
            tasks.append(task)
        elif len(tasks) == number > 0 and tasks[-1].finished is not None:
            break
    if not number or len(tasks) < abs(number):
        names = (record.name for record in log.records(Task))
        hint = f"no task matches {match['path']!r}; {suggestion(match['path'].rpartition('/')[2], names)}"
        if tasks:
            hint = f"{len(tasks)} tasks match {match['path']!r}; #1 is the first, #-1 the last"
        raise NoSuchStep(repr(text), len(log), hint)
    task = tasks[number - 1 if number > 0 else number]
    if match["end"] == "start":
        return task.started.seq
    if task.finished is None:
        raise NoSuchStep(repr(text), len(log), "the recording ends before the end of this task")
    return task.finished.seq


def is_called(task: Node, path: str) -> bool:
    """Return whether the names of a task and of the tasks around it end with a path, such as ``par/moving``."""
    searched = path.strip("/").casefold().split("/")[::-1]
    return [each.name.casefold() for each in task.around()][: len(searched)] == searched


def _at_time(log: RecordReader, seconds: float, text: str) -> int:
    if seconds < 0 or not log.lifetimes:
        raise NoSuchStep(text, len(log), "simulated time starts at 0 s")
    limit = seconds * STEPS_PER_SECOND
    ends = {}
    for lifetime in log.lifetimes:
        end = log.end_of(lifetime)
        if end is not None and end.sim_step > limit:
            return max(0, _passing(log, lifetime, limit) - 1)
        # the last step at which the world is open, because a closed world is empty
        if end is not None and end.sim_step == limit:
            return end.seq - 1 if closes_world(end) else (lifetime.stop or len(log)) - 1
        ends[lifetime.title] = end.sim_step / STEPS_PER_SECOND if end is not None else 0.0
    longest = max(ends, key=lambda title: ends[title])
    raise NoSuchStep(
        text, len(log), f"no world was simulated up to this time; the clock of {longest} ends at {ends[longest]:.3f}s"
    )


def _passing(log: RecordReader, lifetime: Lifetime, limit: float) -> int:
    """Return the first step at which the clock of a world has passed a time."""

    def passes(at: int) -> int | None:
        for record in log.records_of(lifetime, (Mutation, Keyframe), [lifetime.changes[at]]):
            if record.sim_step > limit:
                return record.seq
        return None

    # the clock never goes back, so a binary search finds the first chunk after that time
    first = bisect_left(range(len(lifetime.changes) - 1), True, key=lambda at: passes(at) is not None)
    return passes(first) or 0
