"""Parts of the sentences that tell causes: tasks, lines of the plan, changes, and what was waited for."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from recorder.records import Fluent, Query, argument_values, format_failure, from_json
from replay.report import phrases

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Task
    from recorder.tasks import Node
    from replay.explain.causes.cause import Change, Fulfiller, Pending
    from replay.history.source import Line

_MAX_NAMED: Final = 3


def task_text(task: Node) -> str:
    """Return a task with what it was given."""
    return phrases.task(task.kind, task.name, task.parameters)


def error_text(task: Node) -> str:
    """Return what a task failed with, in a line."""
    return phrases.one_line(task.error[1] or task.error[0]) if task.error is not None else task.status.word


def place(line: Line) -> str:
    """Return a line of the plan, as file:line."""
    return f"{phrases.path(line.file)}:{line.number}"


def originator(change: Change) -> str:
    """Return what made a change, and the plan's line."""
    if change.by_fork:
        return ", by the fork"
    task, handler = change.task, change.handler
    called = phrases.task(task.kind, task.name, argument_values(task.parameters)) if task is not None else ""
    by = (
        f", by {handler_text(handler) if handler is not None and task is handler else called}"
        if task is not None
        else ""
    )
    by += f", at {place(change.line)}" if change.line is not None else ""
    return by + (f", in {handler_text(handler)}" if handler is not None and task is not handler else "")


def handler_text(handler: Task) -> str:
    """Return a handler's call, with the step of its event."""
    event = argument_values(handler.parameters).get("event", "")
    step = f" of step {handler.cause}" if handler.cause else ""  # 0: the event came before the recording
    return f"the handler {handler.name} of event {event}{step}"


def since_when(change: Change | None, verb: str) -> str:
    """Return since when something is so, and by what; "" if it always was."""
    if change is None:
        return ""
    return f", {verb + ' ' if verb else ''}{'at' if verb else 'since'} step {change.step}{originator(change)}"


def change_text(change: Change) -> str:
    """Return a change: what, by how much, and by whom."""
    name = f"{change.body}.{change.joint}" if change.joint else change.body
    size = phrases.length(change.distance) if math.isfinite(change.distance) else ""
    words = {
        "detached": f"{name} was detached",
        "attached": f"{name} was taken",
        "load": f"{name} was loaded",
        "command": f"{name} was moved",
        "carried": f"{name} was carried{f' by {change.mover}' if change.mover else ''}",
        "along": f"{name} moved along{f' with {change.mover}' if change.mover else ''}",
        "in-hand": f"{name} was moved itself while a hand held it, off that hand",
        "driven": f"{name} followed a trajectory",
        "physics": f"{name} moved in simulation",
        "removed": f"{name} was removed",
        "joints": f"joints of {name} moved",
        "gravity": "gravity was set",
        "reset": f"{name} moved when the world was reset",
        "restored": f"{name} moved when a saved state was restored",
    }
    by = f" by {size}" if change.distance and size and not change.joint else ""
    return words.get(change.how, f"{name} changed") + by + originator(change)


def doing_text(pending: tuple[Pending, ...]) -> str:
    """Return what a part of a plan was doing."""
    doing = [_task_doing(each) for each in pending[:_MAX_NAMED]]
    doing += [f"{len(pending) - _MAX_NAMED} more"] if len(pending) > _MAX_NAMED else []
    return " and ".join(doing) or "running the plan's own code"


def _task_doing(pending: Pending) -> str:
    task = pending.task
    if task.kind == "wait":
        branch = next((each.name for each in task.around() if each.kind == "branch"), "")
        return f"waiting for {task.name}" + (f" in {branch}" if branch else "")
    return f"in {task_text(task)}" if pending.began else f"waiting for the turn of {task_text(task)}"


def pending_lines(pending: Pending) -> Iterator[str]:
    """Yield what it waited for: the values, and who could have fulfilled it."""
    where = f", at {place(pending.line)}" if pending.line is not None else ""
    if pending.task.kind == "wait":
        values = ", ".join(f"{name} = {phrases.value(value)}" for name, value in pending.values.items())
        steps = phrases.names([str(step) for step in pending.changed])
        changed = f"; it got values at steps {steps}" if pending.changed else ""
        yield f"{pending.task.name}: {values}{changed}  [since step {pending.task.started.seq}{where}]"
        yield from (_fulfiller(each) for each in pending.fulfillers)
        if not pending.fulfillers:
            leaves = " or ".join(pending.values) or pending.task.name
            yield f"nothing in the plan's source sets {leaves}, and no record tells who could have"
        return
    if pending.holders:
        names = phrases.names([f"{task_text(task)} (since step {task.started.seq})" for task in pending.holders])
        yield f"{task_text(pending.task)} waited for {names}{where}"


def _fulfiller(each: Fulfiller) -> str:
    if each.failed is not None and each.failed is each.task:
        error = error_text(each.failed)
        return f"{task_text(each.failed)} could have, and failed at step {each.failed.last_step}: {error}"
    inside = f"{each.line.function} at " if each.line is not None and each.line.function not in ("", "<module>") else ""
    where = f"{inside}{place(each.line)} would have: {phrases.short(each.line.text)}" if each.line is not None else ""
    text = where or (
        f"{task_text(each.task)} could have" if each.task is not None else "the plan's own code could have"
    )
    if each.task is not None:
        state = each.task.status.word if each.task.finished is not None else "still running"
        if each.task.finished is not None:
            state += f" at step {each.task.last_step}"
        text += f"; {task_text(each.task)} {'is ' if each.task.finished is None else ''}{state}"
        text += f", having set it at step {each.step}" if each.step is not None else " without that"
    if each.failed is not None:
        text += f", after {task_text(each.failed)} failed at step {each.failed.last_step}: {error_text(each.failed)}"
    if each.refused is not None:
        call = phrases.call(each.refused.name, argument_values(each.refused.arguments))
        error = phrases.one_line(format_failure(each.refused.failure))
        text += f", after {call} was refused at step {each.refused.seq}: {error}"
    if each.task is None and each.step is None:
        text += "; it never did on record"
    return text


def answer_text(record: Query | Task | Fluent) -> str:
    """Return what the plan judged by: an answer, a wait, a failed motion, a fluent's value."""
    if isinstance(record, Query):
        reasons = phrases.reasons(record) if record.candidates else ""
        return f"{phrases.question(record)}: {phrases.answer(record)}" + (f"; {reasons}" if reasons else "")
    if isinstance(record, Fluent):
        at = f", at {phrases.path(record.source_file)}:{record.source_line}" if record.source_line else ""
        return f"{record.name} became {phrases.value(from_json(record.after_json))}{at}"
    if record.kind != "wait":
        return f"{record.name} failed: {phrases.short(phrases.one_line(record.failure.message))}"
    done = "it came true" if from_json(record.result_json) is True else "it didn't come true in time"
    return f"waited for {record.name}: {done}"
