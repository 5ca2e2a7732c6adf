"""What a failed action tried: its choices, what was imagined of them, and the places that it considered for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder.records import Query, argument_values

if TYPE_CHECKING:
    from recorder.records import Plain
    from recorder.tasks import Node
    from replay.file.record_reader import RecordReader

_MAX_PLACES: Final = 5  # queries for places, the last ones


@dataclass(frozen=True, slots=True)
class TriedAction:
    """A failed action.

    Attributes:
        action: its task.
        attempts: of its choices, in their order, each with what was chosen as its parameters.
        imagined: projections of choices, in their order.
        places: queries for places, in its parts too.
        spent: whether its budget was spent.
        last: the choice that could not be made in the end, and why; empty if there was no more to choose from.
    """

    action: Node
    attempts: tuple[Node, ...]
    imagined: tuple[Node, ...]
    places: tuple[Query, ...]
    spent: bool
    last: str


def tried(log: RecordReader, failed: Node) -> TriedAction | None:
    """Return what the outermost failed action tried that a failed task is a part of; None if it is part of none."""
    actions = [task for task in failed.around() if task.kind == "action" and task.failed]
    if not actions:
        return None
    action = actions[-1]
    handling = [task for task in action.children if task.kind == "failure-handling" and "action" in task.parameters]
    parts = [part for task in handling for part in task.children]
    imagined = [part for part in (*action.children, *parts) if part.kind == "projection"]
    ids = {node.id for _, node in action.walk()}
    stop = action.last_step + 1
    asked = [
        query for query in log.records(Query, action.started.seq, stop) if query.HasField("grid") and query.task in ids
    ]
    data = {} if action.failure is None else argument_values(action.failure.data)
    return TriedAction(
        action,
        tuple(part for part in parts if part.kind == "attempt"),
        tuple(imagined),
        tuple(asked[-_MAX_PLACES:]),
        data.get("spent") is True,
        _error_text(data.get("last")),
    )


def _error_text(last: Plain) -> str:
    """Return a recorded error as text."""
    if isinstance(last, dict):
        return str(last.get("repr") or next(iter(last.values()), ""))
    return "" if last is None else str(last)
