"""What a failed action tried: its choices, what was imagined of them, and the places that it considered for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder.records import Query, argument_values
from recorder.records.text import fates_text, foreseen
from replay.report import phrases

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Plain
    from recorder.tasks import Node
    from replay.file.record_reader import RecordReader

_FIRST, _LAST = 3, 3  # attempts that are listed
_MAX_IMAGINED: Final = 6
_MAX_PLACES: Final = 5  # queries for places, the last ones


@dataclass(frozen=True, slots=True)
class TriedAction:
    """A failed action."""

    action: Node
    attempts: tuple[Node, ...]  # of its choices, in order, each with what was chosen as its parameters
    imagined: tuple[Node, ...]  # projections of choices, in order
    places: tuple[Query, ...]  # queries for places, in its parts too
    spent: bool  # its budget
    last: str  # the choice that could not be made in the end, and why; "" if there was no more to choose from

    def lines(self) -> Iterator[str]:
        """Yield the choices of an action, what came of each, and why there was no other."""
        left_out = len(self.attempts) - _FIRST - _LAST
        for number, attempt in enumerate(self.attempts):
            if left_out > 0 and number == _FIRST:
                yield f"... {left_out} more ..."
            if left_out <= 0 or not _FIRST <= number < _FIRST + left_out:
                yield f"step {attempt.started.seq}: {_choice(attempt)}"
                error = attempt.error
                yield f"    {phrases.one_line(': '.join(filter(None, error)))}" if error else "    it has not ended"
        for projection in self.imagined[-_MAX_IMAGINED:]:
            outcome = foreseen(projection.finished) if projection.finished is not None else "it has not ended"
            yield f"step {projection.started.seq}: imagined, {_choice(projection)}"
            yield f"    {outcome}"
        for query in self.places:
            yield f"step {query.seq}: {phrases.question(query)}"
            yield f"    {fates_text(query) or 'no place was left on its map'}"
        if self.last:
            yield f"nothing else could be chosen: {phrases.one_line(self.last)}"
        elif self.spent:
            yield "the budget of tries was spent"
        elif self.attempts:
            yield "there was nothing else to choose"


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


def _choice(task: Node) -> str:
    """Return what was chosen: slots with their values, of places their positions."""
    chosen = [f"{slot}={_value(value)}" for slot, value in task.parameters.items() if value is not None]
    return ", ".join(chosen) or "as asked"


def _value(value: object) -> str:
    if isinstance(value, dict) and isinstance(value.get("position"), list):
        return phrases.vector(value["position"])
    return phrases.value(value)  # type: ignore[arg-type]
