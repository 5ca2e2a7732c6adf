"""Causes of a failure in words: a sentence each, and its steps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import singledispatch
from itertools import groupby
from typing import TYPE_CHECKING, Final

from recorder.records import Query, argument_values, format_failure
from recorder.records.choices import rejection_lines
from recorder.tasks import State
from replay.cli.why_phrases import (
    answer_text,
    change_text,
    doing_text,
    error_text,
    handler_text,
    originator,
    pending_lines,
    place,
    since_when,
    task_text,
)
from replay.explain.causes import cause as kinds
from replay.explain.causes.timeout import duration
from replay.report import phrases

if TYPE_CHECKING:
    from replay.explain.causes.cause import Cause

_FAST: Final = 0.1  # m/s from which on the speed of what is let go of is given
_SPINNING: Final = 1.0  # rad/s, likewise
_LACKED: Final = {
    "held": "so the {arm} gripper didn't hold {subject}",
    "hand-free": "so the {arm} gripper still held {subject}",
    "clear": "so {subject} was where it had been",
    "joint-moved": "so {subject} was as it had been",
    "at-pose": "so the robot wasn't where it should have been",
    "posture": "so the {arm} arm wasn't in that posture",
    "camera-directed": "so the camera looked elsewhere",
    "result": "so {subject} had no value from it",
}


_MISSED: Final = {
    "moved": "so {subject} was where it had been",
    "loaded": "so there was no {subject}",
    "held": "so nothing held {subject}",
    "hand-free": "so {subject} was still held",
}


def lines(cause: Cause) -> Iterator[str]:
    """Yield a cause as a sentence, and what else there is to it as indented lines."""
    first, *more = _words(cause)
    yield first
    yield from (f"  {line}" for line in more)


def first_line(cause: Cause) -> str:
    """Return a cause as a sentence."""
    return next(_words(cause))


@singledispatch
def _words(cause: Cause) -> Iterator[str]:
    yield f"{cause.kind}: steps {phrases.names([str(step) for step in cause.steps])}"


@_words.register
def _(cause: kinds.Swallowed) -> Iterator[str]:
    failed = cause.failed
    lacked = _LACKED[cause.precondition].format(subject=cause.subject, arm=cause.arm).replace("the  ", "the ")
    at = f" at {place(cause.line)}" if cause.line is not None else ""
    how = f"{at} was cancelled" if failed.status is State.CANCELLED else f"{at} failed"
    on = f" at {place(cause.went_on)}" if cause.went_on is not None else ""
    lacked += f" at step {cause.steps[-1]}"
    if cause.skipped is not None:
        skipped = f"{place(cause.skipped)} was skipped: {cause.skipped.text}"
        lacked = f"so {cause.subject} had nothing from it, and {skipped}"
    yield f"{task_text(failed)}{how} at step {failed.last_step} and the plan went on{on}; {lacked}"
    if failed.error is not None:
        yield f"it failed with: {error_text(failed)}"
    for task in cause.also:
        yield f"so did {task_text(task)} at step {task.last_step}: {error_text(task)}"


@_words.register
def _(cause: kinds.Refused) -> Iterator[str]:
    asked, failure = cause.asked, cause.asked.failure
    call = phrases.call(asked.name, argument_values(asked.arguments))
    at = f" at {place(cause.line)}" if cause.line is not None else ""
    on = f" at {place(cause.went_on)}" if cause.went_on is not None else ""
    inside = f", in {handler_text(cause.handler)}," if cause.handler is not None else ""
    lacked = _MISSED.get(cause.precondition, _LACKED.get(cause.precondition, "")).format(subject=cause.subject, arm="")
    lacked = lacked.replace("the  ", "the ")
    refused = f"{call}{at} was refused at step {asked.seq}{inside}"
    yield f"{refused} and the plan went on{on}; {lacked} at step {cause.steps[-1]}"
    yield f"it was refused with: {phrases.one_line(format_failure(failure))}"


@_words.register
def _(cause: kinds.HandState) -> Iterator[str]:
    if cause.precondition == "hand-free":
        since = since_when(cause.change, "taken")
        hand = f"the {cause.holder} gripper" if " (" not in cause.holder else cause.holder
        yield f"{hand} held {cause.body} at step {cause.steps[-1]}{since}"
        return
    hand = f"the {cause.arm} gripper didn't hold {cause.body} at step {cause.steps[-1]}"
    if cause.holder:
        where = f"the {cause.holder} one did" if " " not in cause.holder else f"{cause.holder} did"
        yield f"{hand}: {where}"
    elif cause.change is not None:
        yield f"{hand}{since_when(cause.change, 'let go of')}"
    else:
        yield f"{hand}: nothing had taken it"


@_words.register
def _(cause: kinds.Physics) -> Iterator[str]:
    size = f"by {phrases.length(cause.fall if cause.how == 'fell' else cause.distance)}"
    if cause.tilt >= math.radians(1):
        size += f" and leant over by {math.degrees(cause.tilt):.0f} degrees"
    at = f" at {place(cause.line)}" if cause.line is not None else ""
    yield f"{cause.body} {cause.how} {size} in the simulation of step {cause.moved_at}{at}{_let(cause)}"
    if len(cause.lets) > 1 and not cause.stood_on:
        yield "either may have let it:"
    for change in cause.lets:
        yield f"step {change.step}: {change_text(change)}"


def _let(cause: kinds.Physics) -> str:
    released = next((change for change in cause.lets if change.how == "detached"), None)
    if cause.stood_on:
        return f": {cause.stood_on}, on which {cause.body} stood, was {'removed' if _removed(cause) else 'moved away'}"
    if released is None:
        one = cause.lets[0] if len(cause.lets) == 1 else None
        return f", after {change_text(one)}" if one is not None else ""
    hand = f"the {cause.hand} gripper's hold" if cause.hand and " " not in cause.hand else "its hold"
    motion = []
    if cause.spin is not None and cause.spin >= _SPINNING:
        motion.append(f"turning at {cause.spin:.0f} rad/s")
    if cause.speed is not None and cause.speed >= _FAST:
        motion.append(f"moving at {cause.speed:.1f} m/s")
    return f": it left {hand} at step {released.step}" + (f" while {' and '.join(motion)}" if motion else "")


def _removed(cause: kinds.Physics) -> bool:
    return any(change.how == "removed" for change in cause.lets)


@_words.register
def _(cause: kinds.Raised) -> Iterator[str]:
    what = "the plan raised it itself" if cause.own else f"a mistake of the plan's: {cause.type}"
    inside = f", in {task_text(cause.task)}" if cause.task is not None else ""
    yield f"{what} at {place(cause.line)}{inside}: {phrases.short(cause.line.text)}"
    for answer in cause.answers:
        yield f"before that, at step {answer.seq}: {answer_text(answer)}"


@_words.register
def _(cause: kinds.Timeout) -> Iterator[str]:
    simulated = " of simulated time" if cause.clock == "simulated" else ""
    at = f", at {place(cause.line)}" if cause.line is not None else ""
    yield f"after {cause.seconds:g} s{simulated} it was still {doing_text(cause.pending)}{at}"
    for pending in cause.pending:
        yield from pending_lines(pending)
    if cause.took and not any(pending.task.kind == "wait" for pending in cause.pending):
        times = ((task, round(duration(task, cause.clock) * 1e9)) for task in cause.took)
        took = [f"{task_text(task)} {phrases.seconds(time_ns)}" for task, time_ns in times if time_ns]
        if took:
            yield f"until then: {', '.join(took)}"
        for error, tasks in groupby((task for task in cause.took if task.failed), error_text):
            names = phrases.names([task_text(task) for task in tasks])
            yield f"{names} failed: {error}"
    for each in cause.simulated:
        at = f"{place(each.line)} simulated" if each.line is not None else "simulated were"
        calls = f" in {len(each.steps)} calls" if len(each.steps) > 1 else ""
        yield f"{at} {phrases.number(each.seconds)} s{calls}"


@_words.register
def _(cause: kinds.Interrupted) -> Iterator[str]:
    by = f"interrupted by {cause.by}" if cause.by else "its process ended without closing the recording"
    at = f", at {place(cause.line)}" if cause.line is not None else ""
    yield f"{by} while {doing_text(cause.pending)}{at}"
    for pending in cause.pending:
        yield from pending_lines(pending)


@_words.register
def _(cause: kinds.NoLonger) -> Iterator[str]:
    if isinstance(cause.asked, Query):
        said = f"{phrases.question(cause.asked)} was answered {phrases.answer(cause.asked)}"
        step = cause.asked.seq
    else:
        said, step = f"{task_text(cause.asked)} succeeded", cause.asked.last_step
    yield f"{said} at step {step}, and no longer held at step {cause.steps[-1]}:"
    for change in cause.changes:
        yield f"step {change.step}: {change_text(change)}"


@_words.register
def _(cause: kinds.Misbelief) -> Iterator[str]:
    at = phrases.vector(cause.position)
    yield f"{cause.body} was believed at {at}, {phrases.learned(cause.source, cause.learned)}; {_whereabouts(cause)}"


def _whereabouts(cause: kinds.Misbelief) -> str:
    was = f"at step {cause.steps[-1]} it was {phrases.length(cause.distance)} from there"
    return was if cause.change is None else f"at step {cause.change.step} {change_text(cause.change)}; {was}"


@_words.register
def _(cause: kinds.InTheWay) -> Iterator[str]:
    what = f"{cause.link} of {cause.body}" if cause.link and cause.link != cause.body else cause.body
    whose = f" of {cause.mover}" if cause.mover else " of the camera's view"
    yield f"{what} was in the way{whose}{since_when(cause.change, '')}"


@_words.register
def _(cause: kinds.NoCandidate) -> Iterator[str]:
    asked = cause.asked
    yield f"{phrases.question(asked)} considered {cause.count} at step {asked.seq}, and none would do:"
    yield from rejection_lines(asked)


@_words.register
def _(cause: kinds.OutOfReach) -> Iterator[str]:
    what = cause.body or "the target"
    miss = f"; the {cause.arm} arm stays {phrases.length(cause.miss)} away" if cause.miss is not None else ""
    turned = " in the orientation that was asked for" if cause.orientation else ""
    yield f"{what} was {cause.distance:.2f} m from the robot on the ground{miss}{turned}"
    for change in cause.changes:
        yield f"step {change.step}: {change_text(change)}"


@_words.register
def _(cause: kinds.Gone) -> Iterator[str]:
    yield f"{cause.body} had been removed at step {cause.change.step}{originator(cause.change)}"
    if cause.loaded is not None:
        yield f"step {cause.loaded.step}: another {change_text(cause.loaded)}"
