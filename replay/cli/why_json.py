"""An explanation as JSON data."""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.cli import diff
from replay.cli.blame import line_facts
from replay.state.json_data import record_data

if TYPE_CHECKING:
    from replay.explain.explanation import ChangesSince, Why
    from replay.explain.failed_tasks import TaskExecution


def facts(found: Why) -> dict[str, object]:
    """Return the explanation as JSON data; the keys are part of the command's interface."""
    return {
        "plan": found.run.plan,
        "outcome": found.run.outcome,
        "thread": found.thread,
        "step": found.step,
        "failure": found.failure and {"type": found.failure.type, "message": found.failure.message},
        "raised": [
            {"type": error.type, "message": error.message, "lines": [line_facts(line) for line in error.lines]}
            for error in found.exceptions
        ],
        "task": found.task and _task_facts(found.task),
        "around": [_task_facts(task) for task in found.task.around()] if found.task else [],
        "line": line_facts(found.call_stack[-1]) if found.call_stack else None,
        "callers": [line_facts(line) for line in found.call_stack[:-1]],
        "world": found.world and found.world.name,
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
            for involved in found.bodies
        ],
        "absent": found.removed,
        "tries": [
            _task_facts(attempt.task.motion)
            | {"error": attempt.task.error, "robot": attempt.robot and attempt.robot.pose}
            for attempt in found.attempts
        ],
        "others": found.other_failures,
        "threads": [record_data(record) for record in found.failed_threads],
        "asked": [
            record_data(relevant.query)
            | {"moved_since": relevant.moved, "removed_since": relevant.removed, "other_world": relevant.world}
            for relevant in found.queries
        ],
        "earlier": found.earlier_queries,
        "same": found.since_same_success and _since_facts(found.since_same_success),
        "last": found.since_last_success and _since_facts(found.since_last_success),
        "running": [_task_facts(task) for task in found.unfinished],
    }


def _task_facts(task: TaskExecution) -> dict[str, object]:
    return {
        "id": task.started.task,
        "kind": task.started.kind,
        "name": task.started.name,
        "parameters": task.parameters,
        "steps": [task.started.seq, task.finished and task.finished.seq],
        "error": task.error,
    }


def _since_facts(since: ChangesSince) -> dict[str, object]:
    return {"task": _task_facts(since.task), "difference": diff.facts(since.difference)}
