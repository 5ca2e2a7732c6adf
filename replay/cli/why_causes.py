"""Causes of a failure in words: a sentence each, and its steps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import singledispatch
from itertools import groupby
from typing import TYPE_CHECKING, Final

from recorder.records import Fluent, Query, argument_values, format_failure, from_json
from recorder.records.choices import rejection_lines
from recorder.tasks import State
from replay.cli import formatting, record_text
from replay.explain.causes import cause as kinds
from replay.explain.causes.timeout import duration

if TYPE_CHECKING:
    from recorder.records import Task
    from recorder.tasks import Node
    from replay.explain.causes.cause import Cause, Change, Fulfiller, Pending
    from replay.explain.plan_source import Line

_FAST: Final = 0.1  # m/s from which on the speed of what is let go of is given
_SPINNING: Final = 1.0  # rad/s, likewise
_MAX_NAMED: Final = 3
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
    yield f"{cause.kind}: steps {formatting.names([str(step) for step in cause.steps])}"


@_words.register
def _(cause: kinds.Swallowed) -> Iterator[str]:
    failed = cause.failed
    lacked = _LACKED[cause.precondition].format(subject=cause.subject, arm=cause.arm).replace("the  ", "the ")
    at = f" at {_at(cause.line)}" if cause.line is not None else ""
    how = f"{at} was cancelled" if failed.status is State.CANCELLED else f"{at} failed"
    on = f" at {_at(cause.went_on)}" if cause.went_on is not None else ""
    lacked += f" at step {cause.steps[-1]}"
    if cause.skipped is not None:
        lacked = f"so {cause.subject} had nothing from it, and {_at(cause.skipped)} was skipped: {cause.skipped.text}"
    yield f"{_call(failed)}{how} at step {failed.last_step} and the plan went on{on}; {lacked}"
    if failed.error is not None:
        yield f"it failed with: {_error(failed)}"
    for task in cause.also:
        yield f"so did {_call(task)} at step {task.last_step}: {_error(task)}"


@_words.register
def _(cause: kinds.Refused) -> Iterator[str]:
    asked, failure = cause.asked, cause.asked.failure
    call = formatting.call(asked.name, argument_values(asked.arguments))
    at = f" at {_at(cause.line)}" if cause.line is not None else ""
    on = f" at {_at(cause.went_on)}" if cause.went_on is not None else ""
    inside = f", in {_handler(cause.handler)}," if cause.handler is not None else ""
    lacked = _MISSED.get(cause.precondition, _LACKED.get(cause.precondition, "")).format(subject=cause.subject, arm="")
    lacked = lacked.replace("the  ", "the ")
    refused = f"{call}{at} was refused at step {asked.seq}{inside}"
    yield f"{refused} and the plan went on{on}; {lacked} at step {cause.steps[-1]}"
    yield f"it was refused with: {formatting.one_line(format_failure(failure))}"


@_words.register
def _(cause: kinds.HandState) -> Iterator[str]:
    if cause.precondition == "hand-free":
        since = _since(cause.change, "taken")
        hand = f"the {cause.holder} gripper" if " (" not in cause.holder else cause.holder
        yield f"{hand} held {cause.body} at step {cause.steps[-1]}{since}"
        return
    hand = f"the {cause.arm} gripper didn't hold {cause.body} at step {cause.steps[-1]}"
    if cause.holder:
        where = f"the {cause.holder} one did" if " " not in cause.holder else f"{cause.holder} did"
        yield f"{hand}: {where}"
    elif cause.change is not None:
        yield f"{hand}{_since(cause.change, 'let go of')}"
    else:
        yield f"{hand}: nothing had taken it"


@_words.register
def _(cause: kinds.Physics) -> Iterator[str]:
    size = f"by {formatting.length(cause.fall if cause.how == 'fell' else cause.distance)}"
    if cause.tilt >= math.radians(1):
        size += f" and leant over by {math.degrees(cause.tilt):.0f} degrees"
    at = f" at {_at(cause.line)}" if cause.line is not None else ""
    yield f"{cause.body} {cause.how} {size} in the simulation of step {cause.moved_at}{at}{_let(cause)}"
    if len(cause.lets) > 1 and not cause.stood_on:
        yield "either may have let it:"
    for change in cause.lets:
        yield f"step {change.step}: {_change(change)}"


def _let(cause: kinds.Physics) -> str:
    released = next((change for change in cause.lets if change.how == "detached"), None)
    if cause.stood_on:
        return f": {cause.stood_on}, on which {cause.body} stood, was {'removed' if _removed(cause) else 'moved away'}"
    if released is None:
        one = cause.lets[0] if len(cause.lets) == 1 else None
        return f", after {_change(one)}" if one is not None else ""
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
    inside = f", in {_call(cause.task)}" if cause.task is not None else ""
    yield f"{what} at {_at(cause.line)}{inside}: {formatting.short(cause.line.text)}"
    for answer in cause.answers:
        yield f"before that, at step {answer.seq}: {_answer(answer)}"


@_words.register
def _(cause: kinds.Timeout) -> Iterator[str]:
    simulated = " of simulated time" if cause.clock == "simulated" else ""
    at = f", at {_at(cause.line)}" if cause.line is not None else ""
    yield f"after {cause.seconds:g} s{simulated} it was still {_doing(cause.pending)}{at}"
    for pending in cause.pending:
        yield from _pending(pending)
    if cause.took and not any(pending.task.kind == "wait" for pending in cause.pending):
        times = ((task, round(duration(task, cause.clock) * 1e9)) for task in cause.took)
        took = [f"{_call(task)} {formatting.seconds(time_ns)}" for task, time_ns in times if time_ns]
        if took:
            yield f"until then: {', '.join(took)}"
        for error, tasks in groupby((task for task in cause.took if task.failed), _error):
            names = formatting.names([_call(task) for task in tasks])
            yield f"{names} failed: {error}"
    for each in cause.simulated:
        at = f"{_at(each.line)} simulated" if each.line is not None else "simulated were"
        calls = f" in {len(each.steps)} calls" if len(each.steps) > 1 else ""
        yield f"{at} {formatting.number(each.seconds)} s{calls}"


@_words.register
def _(cause: kinds.Interrupted) -> Iterator[str]:
    by = f"interrupted by {cause.by}" if cause.by else "its process ended without closing the recording"
    at = f", at {_at(cause.line)}" if cause.line is not None else ""
    yield f"{by} while {_doing(cause.pending)}{at}"
    for pending in cause.pending:
        yield from _pending(pending)


@_words.register
def _(cause: kinds.NoLonger) -> Iterator[str]:
    if isinstance(cause.asked, Query):
        said = f"{record_text.question(cause.asked)} was answered {record_text.answer(cause.asked)}"
        step = cause.asked.seq
    else:
        said, step = f"{_call(cause.asked)} succeeded", cause.asked.last_step
    yield f"{said} at step {step}, and no longer held at step {cause.steps[-1]}:"
    for change in cause.changes:
        yield f"step {change.step}: {_change(change)}"


@_words.register
def _(cause: kinds.InTheWay) -> Iterator[str]:
    what = f"{cause.link} of {cause.body}" if cause.link and cause.link != cause.body else cause.body
    whose = f" of {cause.mover}" if cause.mover else " of the camera's view"
    yield f"{what} was in the way{whose}{_since(cause.change, '')}"


@_words.register
def _(cause: kinds.NoCandidate) -> Iterator[str]:
    asked = cause.asked
    yield f"{record_text.question(asked)} considered {cause.count} at step {asked.seq}, and none would do:"
    yield from rejection_lines(asked)


@_words.register
def _(cause: kinds.OutOfReach) -> Iterator[str]:
    what = cause.body or "the target"
    miss = f"; the {cause.arm} arm stays {formatting.length(cause.miss)} away" if cause.miss is not None else ""
    turned = " in the orientation that was asked for" if cause.orientation else ""
    yield f"{what} was {cause.distance:.2f} m from the robot on the ground{miss}{turned}"
    for change in cause.changes:
        yield f"step {change.step}: {_change(change)}"


@_words.register
def _(cause: kinds.Gone) -> Iterator[str]:
    yield f"{cause.body} had been removed at step {cause.change.step}{_by(cause.change)}"
    if cause.loaded is not None:
        yield f"step {cause.loaded.step}: another {_change(cause.loaded)}"


# --- parts of sentences ----------------------------------------------------------------------------------------------


def _call(task: Node) -> str:
    return formatting.task(task.kind, task.name, task.parameters)


def _error(task: Node) -> str:
    return formatting.one_line(task.error[1] or task.error[0]) if task.error is not None else task.status.word


def _at(line: Line) -> str:
    return f"{formatting.path(line.file)}:{line.number}"


def _by(change: Change) -> str:
    """Return what made a change, and the plan's line."""
    if change.by_fork:
        return ", by the fork"
    task, handler = change.task, change.handler
    called = formatting.task(task.kind, task.name, argument_values(task.parameters)) if task is not None else ""
    by = f", by {_handler(handler) if handler is not None and task is handler else called}" if task is not None else ""
    by += f", at {_at(change.line)}" if change.line is not None else ""
    return by + (f", in {_handler(handler)}" if handler is not None and task is not handler else "")


def _handler(handler: Task) -> str:
    """Return a handler's call, with the step of its event."""
    event = argument_values(handler.parameters).get("event", "")
    step = f" of step {handler.cause}" if handler.cause else ""  # 0: the event came before the recording
    return f"the handler {handler.name} of event {event}{step}"


def _since(change: Change | None, verb: str) -> str:
    if change is None:
        return ""
    return f", {verb + ' ' if verb else ''}{'at' if verb else 'since'} step {change.step}{_by(change)}"


def _change(change: Change) -> str:
    name = f"{change.body}.{change.joint}" if change.joint else change.body
    size = formatting.length(change.distance) if math.isfinite(change.distance) else ""
    words = {
        "detached": f"{name} was detached",
        "attached": f"{name} was taken",
        "load": f"{name} was loaded",
        "command": f"{name} was moved",
        "carried": f"{name} was carried{f' by {change.mover}' if change.mover else ''}",
        "along": f"{name} moved along{f' with {change.mover}' if change.mover else ''}",
        "in-hand": f"{name} was moved itself while a hand held it, off that hand",
        "physics": f"{name} moved in simulation",
        "removed": f"{name} was removed",
        "joints": f"joints of {name} moved",
        "gravity": "gravity was set",
        "reset": f"{name} moved when the world was reset",
        "restored": f"{name} moved when a saved state was restored",
    }
    by = f" by {size}" if change.distance and size and not change.joint else ""
    return words.get(change.how, f"{name} changed") + by + _by(change)


def _doing(pending: tuple[Pending, ...]) -> str:
    doing = [_task_doing(each) for each in pending[:_MAX_NAMED]]
    doing += [f"{len(pending) - _MAX_NAMED} more"] if len(pending) > _MAX_NAMED else []
    return " and ".join(doing) or "running the plan's own code"


def _task_doing(pending: Pending) -> str:
    task = pending.task
    if task.kind == "wait":
        branch = next((each.name for each in task.around() if each.kind == "branch"), "")
        return f"waiting for {task.name}" + (f" in {branch}" if branch else "")
    return f"in {_call(task)}" if pending.began else f"waiting for the turn of {_call(task)}"


def _pending(pending: Pending) -> Iterator[str]:
    where = f", at {_at(pending.line)}" if pending.line is not None else ""
    if pending.task.kind == "wait":
        values = ", ".join(f"{name} = {formatting.value(value)}" for name, value in pending.values.items())
        steps = formatting.names([str(step) for step in pending.changed])
        changed = f"; it got values at steps {steps}" if pending.changed else ""
        yield f"{pending.task.name}: {values}{changed}  [since step {pending.task.started.seq}{where}]"
        yield from (_fulfiller(each) for each in pending.fulfillers)
        if not pending.fulfillers:
            leaves = " or ".join(pending.values) or pending.task.name
            yield f"nothing in the plan's source sets {leaves}, and no record tells who could have"
        return
    if pending.holders:
        names = formatting.names([f"{_call(task)} (since step {task.started.seq})" for task in pending.holders])
        yield f"{_call(pending.task)} waited for {names}{where}"


def _fulfiller(each: Fulfiller) -> str:
    if each.failed is not None and each.failed is each.task:
        return f"{_call(each.failed)} could have, and failed at step {each.failed.last_step}: {_error(each.failed)}"
    inside = f"{each.line.function} at " if each.line is not None and each.line.function not in ("", "<module>") else ""
    where = f"{inside}{_at(each.line)} would have: {formatting.short(each.line.text)}" if each.line is not None else ""
    text = where or (f"{_call(each.task)} could have" if each.task is not None else "the plan's own code could have")
    if each.task is not None:
        state = each.task.status.word if each.task.finished is not None else "still running"
        if each.task.finished is not None:
            state += f" at step {each.task.last_step}"
        text += f"; {_call(each.task)} {'is ' if each.task.finished is None else ''}{state}"
        text += f", having set it at step {each.step}" if each.step is not None else " without that"
    if each.failed is not None:
        text += f", after {_call(each.failed)} failed at step {each.failed.last_step}: {_error(each.failed)}"
    if each.refused is not None:
        call = formatting.call(each.refused.name, argument_values(each.refused.arguments))
        error = formatting.one_line(format_failure(each.refused.failure))
        text += f", after {call} was refused at step {each.refused.seq}: {error}"
    if each.task is None and each.step is None:
        text += "; it never did on record"
    return text


def _answer(record: Query | Task | Fluent) -> str:
    if isinstance(record, Query):
        reasons = record_text.reasons(record) if record.candidates else ""
        return f"{record_text.question(record)}: {record_text.answer(record)}" + (f"; {reasons}" if reasons else "")
    if isinstance(record, Fluent):
        at = f", at {formatting.path(record.source_file)}:{record.source_line}" if record.source_line else ""
        return f"{record.name} became {formatting.value(from_json(record.after_json))}{at}"
    if record.kind != "wait":
        return f"{record.name} failed: {formatting.short(formatting.one_line(record.failure.message))}"
    done = "it came true" if from_json(record.result_json) is True else "it didn't come true in time"
    return f"waited for {record.name}: {done}"
