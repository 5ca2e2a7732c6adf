"""An explanation for machines."""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.cli import diff
from replay.state.json_data import record_data

if TYPE_CHECKING:
    from replay.explain.explanation import Since, Why
    from replay.explain.failed_tasks import Attempt
    from replay.explain.source import Line


def facts(found: Why) -> dict[str, object]:
    """The explanation, for machines.

    Args:
        found: the explanation.
    """
    return {
        "plan": found.run.plan,
        "outcome": found.run.outcome,
        "thread": found.thread,
        "step": found.step,
        "failure": found.failure and {"type": found.failure.type, "message": found.failure.message},
        "raised": [
            {"type": error.type, "message": error.message, "lines": [_line_facts(line) for line in error.lines]}
            for error in found.raised
        ],
        "task": found.task and _task_facts(found.task),
        "around": [_task_facts(task) for task in found.task.around()] if found.task else [],
        "line": _line_facts(found.way[-1]) if found.way else None,
        "callers": [_line_facts(line) for line in found.way[:-1]],
        "world": found.world and found.world.name,
        "things": [
            {
                "object": thing.body.name,
                "position": thing.body.position,
                "orientation": thing.body.orientation,
                "held_by": thing.held and thing.held.carrier,
                "holds": [held.body for held in thing.holds],
                "distance": thing.distance,
                "bearing": thing.bearing,
            }
            for thing in found.things
        ],
        "absent": found.absent,
        "tries": [
            _task_facts(each.task.motion) | {"error": each.task.error, "robot": each.robot and each.robot.pose}
            for each in found.tries
        ],
        "others": found.others,
        "threads": [record_data(each) for each in found.threads],
        "asked": [
            record_data(asked.query)
            | {"moved_since": asked.moved, "removed_since": asked.gone, "other_world": asked.world}
            for asked in found.asked
        ],
        "earlier": found.earlier,
        "same": found.same and _since_facts(found.same),
        "last": found.last and _since_facts(found.last),
        "running": [_task_facts(task) for task in found.running],
    }


def _line_facts(line: Line) -> dict[str, object]:
    return {"file": line.file, "line": line.number, "function": line.function, "text": line.text}


def _task_facts(task: Attempt) -> dict[str, object]:
    return {
        "id": task.started.task,
        "kind": task.started.kind,
        "name": task.started.name,
        "parameters": task.parameters,
        "steps": [task.started.seq, task.finished and task.finished.seq],
        "error": task.error,
    }


def _since_facts(since: Since) -> dict[str, object]:
    return {"task": _task_facts(since.task), "difference": diff.facts(since.difference)}
