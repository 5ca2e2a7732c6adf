"""Failures that the plan swallowed, and that made a later motion fail.

Of what a failed motion lacked, the last motion that should have brought it about had failed, or was cancelled: with the
same object, the same arm, the same joint. Or it was skipped, for want of what a perception would have found. A later
success of such a motion ends that, as does any other change that did it, or something else, to the same: a plan that
attached the object itself and let go of it then failed for that.
"""

from __future__ import annotations

import ast
import builtins
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Final

from recorder.records import Mutation, Task
from recorder.tasks import State
from replay.explain.causes.cause import Swallowed
from replay.explain.causes.preconditions import about, lacking
from replay.explain.causes.skipped import skipped

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from recorder.tasks import Node
    from replay.explain.causes.case import Case
    from replay.explain.causes.preconditions import Lacking
    from replay.history.source import Line

_UNSUCCESSFUL: Final = (State.FAILED, State.CANCELLED)
_MISSING_VALUE: Final = ("DesignatorError", "BadArgument")  # that a plan's None makes, beside Python's own errors
_EMPTY: Final = ("IndexError", "KeyError", "StopIteration")  # that a list or the like makes which lacks a value
_MAX_ALSO: Final = 3
_MAX_SETTING: Final = 100  # motions that may have put something into a list
_SEARCHED: Final = 2000  # records in which a plan goes on after a failure


def find(case: Case) -> Iterator[Swallowed]:
    """Yield the failures for want of which the case's motion, or line, failed."""
    for lack in lacking(case):
        last = next((motion for motion in case.motions(*lack.motions) if lack.fits(motion)), None)
        if last is not None and last.status in _UNSUCCESSFUL and not _done_since(case, lack, last):
            also = _also(case, lack, last)
            yield _swallowed(case, lack.precondition, lack.subject, lack.arm, last, also)
        found = skipped(case, lack) if last is None else None
        if found is not None and not _done_since(case, lack, found[0]):
            motion, name, line = found
            yield replace(_swallowed(case, "result", name, "", motion), skipped=line)
    yield from _results(case)


def _done_since(case: Case, lack: Lacking, failed: Node) -> bool:
    changes = case.log.records(Mutation, failed.last_step + 1, case.began)
    here = case.world.name if case.world is not None else ""
    return any(isinstance(each, Mutation) and each.world == here and lack.done_by(each) for each in changes)


def _swallowed(
    case: Case, precondition: str, subject: str, arm: str, failed: Node, also: tuple[Node, ...] = ()
) -> Swallowed:
    step, went_on = _went_on(case, max((failed, *also), key=lambda task: task.last_step))
    steps = {failed.last_step, *([step] if step else []), case.step, *(task.last_step for task in also)}
    line = case.line_of(failed.started)
    return Swallowed(tuple(sorted(steps)), precondition, subject, arm, failed, line, went_on, also)


def _also(case: Case, lack: Lacking, failed: Node) -> tuple[Node, ...]:
    """Return the other motions, with any arm, that would have done as well and failed, since one succeeded."""
    found: list[Node] = []
    for motion in case.motions(*lack.motions) if lack.arm else ():
        if not about(motion, body=lack.subject):
            continue
        if motion.status not in _UNSUCCESSFUL:
            break
        if motion is not failed and motion.error not in [each.error for each in (failed, *found)]:
            found.append(motion)
    return tuple(found[:_MAX_ALSO][::-1])


def _went_on(case: Case, failed: Node) -> tuple[int, Line | None]:
    """Return the step with which the plan went on after a failure, and its line."""
    outer = failed.outermost_failed
    stack = case.source.call_stack(outer.started)
    around = {node.id for node in outer.around()} - {outer.id} | {0}
    stop = min(case.began + 1, outer.last_step + _SEARCHED)
    return went_on(case, outer.last_step + 1, stop, around, outer.started.thread, stack)


def went_on(
    case: Case, start: int, stop: int, around: Collection[int], thread: str, stack: Sequence[Line]
) -> tuple[int, Line | None]:
    """Return the first step with which a part of the plan went on, and its line; 0 and None if there is none.

    Args:
        case: the case.
        start: the step from which on to look.
        stop: the step before which to look.
        around: ids of the tasks that are that part, 0 for the plan itself.
        thread: name of its thread.
        stack: the plan's lines after which it went on.
    """
    for record in case.log.records((Task, Mutation), start, stop):
        if not isinstance(record, Task | Mutation) or (isinstance(record, Task) and record.phase == Task.FINISHED):
            continue
        parent = record.parent if isinstance(record, Task) else record.task
        lines = case.source.call_stack(record) if parent in around else ()
        if lines and record.thread == thread:
            if list(lines) == list(stack):  # in the next round of a loop
                return record.seq, case.line(lines)
            fresh = (line for line, before in zip(lines, stack, strict=False) if line != before)
            return record.seq, next(fresh, lines[min(len(stack), len(lines) - 1)])
    return 0, None


def _results(case: Case) -> Iterator[Swallowed]:
    """Yield the failures that left without a value, or empty, what the failed line reads."""
    setting = _setting(case) if lacks_value(case) else iter(())
    if case.failure.type in _EMPTY:  # several things may have been put into it
        found = list(islice(setting, _MAX_SETTING))
        succeeded = [motion.parameters for motion, _ in found if motion.status not in _UNSUCCESSFUL]
        missing = [each for each in found if each[0].status in _UNSUCCESSFUL and each[0].parameters not in succeeded]
        key = case.failure.message.strip("'") if case.failure.type == "KeyError" else ""
        named = [each for each in missing if key and key in each[0].parameters.values()]
        last = next(iter(named or missing), None)
    else:
        last = next(setting, None)
    if last is not None and last[0].status in _UNSUCCESSFUL:
        yield _swallowed(case, "result", ", ".join(last[1]), "", last[0])


def _setting(case: Case) -> Iterator[tuple[Node, list[str]]]:
    """Yield the earlier motions whose lines set variables that the failed line reads, the last first, and these."""
    for motion in reversed(case.failed.motions):
        if motion.last_step < case.step and motion is not case.motion:
            names = values_from(case, case.source.call_stack(motion.started))
            if names:
                yield motion, names


def lacks_value(case: Case) -> bool:
    """Return whether a line of the plan failed for want of a value."""
    own_mistake = hasattr(builtins, case.failure.type) or case.failure.type in _MISSING_VALUE
    if case.failure.type in _EMPTY:
        return True
    texts = (case.failure.message, *(case.motion.parameters.values() if case.motion is not None else ()))
    return own_mistake and any(text is None or "None" in str(text) or _unset(case, str(text)) for text in texts)


def values_from(case: Case, setting: Sequence[Line]) -> list[str]:
    """Return the variables that some lines of the plan set, and those that failed read."""
    stack = case.source.call_stack(case.task.motion.started) if case.task is not None else ()
    lines = (*stack, *(line for error in case.traced for line in error.lines))
    places = [{(line.file, line.number) for line in each} for each in (lines, setting)]
    shared = places[0] & places[1]  # of helpers that perform both
    read, written = (
        case.names_in([line for line in each if (line.file, line.number) not in shared], context)
        for each, context in ((lines, ast.Load), (setting, ast.Store))
    )
    return sorted(name for _, name in read & written)


def _unset(case: Case, text: str) -> bool:
    return case.failure.type in ("NameError", "UnboundLocalError") and text == case.failure.message
