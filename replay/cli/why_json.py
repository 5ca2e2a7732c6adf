"""An explanation as JSON data."""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.cli import diff
from replay.cli.blame import call_stack_facts, line_facts
from replay.state.json_data import message_data, record_data

if TYPE_CHECKING:
    from recorder.records import Plain
    from recorder.tasks import Node
    from replay.explain.why_data import ChangesSince, Why


def facts(why: Why) -> dict[str, object]:
    """Return the explanation as JSON data; the keys are part of the command's interface."""
    return {
        "plan": why.run.plan,
        "outcome": why.run.outcome,
        "thread": why.thread,
        "step": why.step,
        "failure": why.failure and {"type": why.failure.type, "message": why.failure.message},
        "raised": [
            {"type": error.type, "message": error.message, "lines": [line_facts(line) for line in error.lines]}
            for error in why.exceptions
        ],
        "task": why.task and _task_facts(why.task),
        "around": [_task_facts(task) for task in why.task.around()] if why.task else [],
        **call_stack_facts(why.call_stack),
        "variables": [
            {"file": file, "line": line, "values": dict(values)} for (file, line), values in why.variables.items()
        ],
        "world": why.world and why.world.name,
        "things": [
            {
                "object": involved.body.name,
                "position": involved.body.position,
                "orientation": involved.body.orientation,
                "held_by": involved.held and involved.held.carrier,
                "holds": [held.body for held in involved.holds],
                "distance": involved.distance,
                "bearing": involved.bearing,
            }
            for involved in why.bodies
        ],
        "absent": why.removed,
        "tries": [
            _task_facts(attempt.task.motion)
            | {"error": attempt.task.error, "robot": attempt.robot and attempt.robot.pose}
            for attempt in why.attempts
        ],
        "others": why.other_failures,
        "threads": [record_data(record) for record in why.failed_threads],
        "choices": [record_data(choice) for choice in why.choices],
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
    }


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
