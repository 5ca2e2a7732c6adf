"""What a failed action tried, as text: each choice with what came of it, and of how many places."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records.places import fates_text
from recorder.records.projections import foreseen
from replay.report import phrases

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.tasks import Node
    from replay.explain.tried import TriedAction

_FIRST, _LAST = 3, 3  # attempts that are listed
_MAX_IMAGINED: Final = 6


def lines(tried: TriedAction) -> Iterator[str]:
    """Yield the choices of an action, what came of each, and why there was no other."""
    left_out = len(tried.attempts) - _FIRST - _LAST
    for number, attempt in enumerate(tried.attempts):
        if left_out > 0 and number == _FIRST:
            yield f"... {left_out} more ..."
        if left_out <= 0 or not _FIRST <= number < _FIRST + left_out:
            yield f"step {attempt.started.seq}: {_choice(attempt)}"
            error = attempt.error
            yield f"    {phrases.one_line(': '.join(filter(None, error)))}" if error else "    it has not ended"
    for projection in tried.imagined[-_MAX_IMAGINED:]:
        outcome = foreseen(projection.finished) if projection.finished is not None else "it has not ended"
        yield f"step {projection.started.seq}: imagined, {_choice(projection)}"
        yield f"    {outcome}"
    for query in tried.places:
        yield f"step {query.seq}: {phrases.question(query)}"
        yield f"    {fates_text(query) or 'no place was left on its map'}"
    if tried.last:
        yield f"nothing else could be chosen: {phrases.one_line(tried.last)}"
    elif tried.spent:
        yield "the budget of tries was spent"
    elif tried.attempts:
        yield "there was nothing else to choose"


def _choice(task: Node) -> str:
    """Return what was chosen: slots with their values, of places their positions."""
    chosen = [f"{slot}={_value(value)}" for slot, value in task.parameters.items() if value is not None]
    return ", ".join(chosen) or "as asked"


def _value(value: object) -> str:
    if isinstance(value, dict) and isinstance(value.get("position"), list):
        return phrases.vector(value["position"])
    return phrases.value(value)  # type: ignore[arg-type]
