"""An explanation as JSON data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING

from recorder.records import Fluent, Query, Refusal, Task
from recorder.records.places import fates_text
from recorder.records.projections import foreseen
from recorder.tasks import Node
from replay.cli import diff, why_causes
from replay.history.source import Line
from replay.report import report
from replay.state.json_data import message_data, record_data

if TYPE_CHECKING:
    from recorder.records import Plain
    from replay.explain.causes.cause import Cause
    from replay.explain.causes.why_data import ChangesSince, InvolvedBody, Why
    from replay.explain.tried import TriedAction


def facts(why: Why) -> dict[str, object]:
    """Return the explanation as JSON data; the keys are part of the command's interface."""
    return {
        "plan": why.run.plan,
        "outcome": why.run.outcome,
        "thread": why.thread,
        "step": why.step,
        "failure": why.failure and {"type": why.failure.type, "message": why.failure.message},
        "raised": [
            {
                "type": error.type,
                "message": error.message,
                "lines": [report.data(line) for line in error.lines],
            }
            for error in why.exceptions
        ],
        "causes": [_cause_facts(cause) for cause in why.causes],
        "task": why.task and _task_facts(why.task),
        "around": [_task_facts(task) for task in why.task.around()] if why.task else [],
        **report.call_stack(why.call_stack),
        "variables": [
            {"file": file, "line": line, "values": dict(values)} for (file, line), values in why.variables.items()
        ],
        "world": why.world and why.world.name,
        "things": [_thing(involved) for involved in why.bodies],
        "branches": [
            {
                "task": _task_facts(branch.task),
                "line": branch.line and report.data(branch.line),
                "things": [_thing(involved) for involved in branch.bodies],
                "causes": [_cause_facts(cause) for cause in branch.causes],
            }
            for branch in why.branches
        ],
        "absent": why.removed,
        "tries": [
            _task_facts(attempt.task.motion)
            | {"error": attempt.task.error, "robot": attempt.robot and attempt.robot.pose}
            for attempt in why.attempts
        ],
        "others": why.other_failures,
        "forgotten": why.forgotten,
        "threads": [record_data(record) for record in why.failed_threads],
        "choices": [record_data(choice) for choice in why.choices],
        "tried": why.tried and _tried_facts(why.tried),
        "decision": _decision(why),
        "asked": [
            record_data(relevant.query)
            | {"moved_since": relevant.moved, "removed_since": relevant.removed, "other_world": relevant.world}
            for relevant in why.queries
        ],
        "earlier": why.earlier_queries,
        "same": why.since_same_success and _since_facts(why.since_same_success),
        "last": why.since_last_success and _since_facts(why.since_last_success),
        "running": [_task_facts(task) for task in why.unfinished],
        "endless": [_task_facts(task) for task in why.endless],
    }


def _thing(involved: InvolvedBody) -> dict[str, object]:
    return {
        "object": involved.body.name,
        "position": involved.body.position,
        "orientation": involved.body.orientation,
        "held_by": involved.held and involved.held.carrier,
        "holds": [held.body for held in involved.holds],
        "hands": dict(involved.hands),
        "links": {name: {"position": pose[0], "orientation": pose[1]} for name, pose in involved.links.items()},
        "joints": dict(involved.joints),
        "distance": involved.distance,
        "bearing": involved.bearing,
    }


def _tried_facts(tried: TriedAction) -> dict[str, object]:
    return {
        "action": _task_facts(tried.action),
        "attempts": [_task_facts(attempt) | {"error": attempt.error} for attempt in tried.attempts],
        "imagined": [
            _task_facts(each) | {"foreseen": foreseen(each.finished) if each.finished is not None else ""}
            for each in tried.imagined
        ],
        "places": [
            {"step": query.seq, "name": query.name, "considered": len(query.grid.spots), "text": fates_text(query)}
            for query in tried.places
        ],
        "spent": tried.spent,
        "last": tried.last,
    }


def _cause_facts(cause: Cause) -> dict[str, object]:
    """Return a cause: its kind, its steps, it in words, and the fields of its class."""
    own = {each.name: _plain(getattr(cause, each.name)) for each in fields(cause) if each.name != "steps"}
    return {"kind": cause.kind, "steps": list(cause.steps), "text": " ".join(why_causes.lines(cause)), **own}


def _plain(value: object) -> object:
    """Return a field of a cause: tasks, lines of the plan and records as elsewhere in the data."""
    if isinstance(value, Node):
        return _task_facts(value)
    if isinstance(value, Line):
        return report.data(value)
    if isinstance(value, Task | Query | Refusal | Fluent):
        return record_data(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {each.name: _plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return dict(value) if isinstance(value, Mapping) else value


def _task_facts(task: Node) -> dict[str, object]:
    return {
        "id": task.id,
        "kind": task.kind,
        "name": task.name,
        "parameters": task.parameters,
        "steps": [task.started.seq, task.finished and task.finished.seq],
        "error": task.error,
    }


def _decision(why: Why) -> Plain:
    """Return how the failed motion was decided; None if that isn't on record."""
    decision = why.task.motion.decision if why.task is not None else None
    return message_data(decision) if decision is not None else None


def _since_facts(since: ChangesSince) -> dict[str, object]:
    return {"task": _task_facts(since.task), "difference": diff.facts(since.difference)}
