"""Changes of expressions about recorded states, such as ``milk.z``, ``holding(left)``, ``distance(pr2, cup) < 1``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from recorder.errors import suggestion
from recorder.properties.expressions import PARTS, ROUNDING, BadProperty, NoValue, PropertyExpression, Scene, plain
from recorder.records import Keyframe, Mutation
from recorder.records.fold import FoldedWorld, apply
from replay.errors import ReplayError
from replay.report.question import written
from replay.state.fold import state_at

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader


class NoQuantity(ReplayError):
    """An expression has no value in any recorded state, for example because a name is unknown."""

    def __init__(self, expression: str, cause: str) -> None:
        super().__init__(f"{expression}: {cause}")
        self.expression = expression


class ValueChange(NamedTuple):
    """The change of an expression's value at a step."""

    step: int
    before: object
    after: object


def value_changes(log: RecordReader, expression: str) -> list[ValueChange]:
    """Return the changes of an expression's value in a recording (:mod:`recorder.properties.expressions`).

    Values are None before an object is loaded, and after it is removed.

    Raises:
        NoQuantity: The expression has no value at any step.
    """
    try:
        compiled = PropertyExpression(expression)
    except BadProperty as error:
        raise NoQuantity(expression, error.cause) from None
    worlds: dict[str, FoldedWorld] = {}
    scene = Scene(worlds)
    found: list[ValueChange] = []
    latest: object = None
    known, cause = False, NoValue("the recording has no state")
    names = set[str]()
    for record in log.records((Mutation, Keyframe)):
        apply(worlds, record)
        try:
            value = plain(compiled.value(scene))
            known = True
        except NoValue as error:
            value = None
            cause = error if error.name or not cause.name else cause
            names.update(error.known)
        if _differ(latest, value):
            found.append(ValueChange(record.seq, latest, value))
            latest = value
    if not known:
        raise NoQuantity(expression, f"{cause}{f'; {suggestion(cause.name, names)}' if cause.known else ''}")
    return found


def _differ(before: object, after: object) -> bool:
    if isinstance(before, float) and isinstance(after, float):
        return abs(before - after) > ROUNDING
    if isinstance(before, tuple) and isinstance(after, tuple) and len(before) == len(after):
        return any(map(_differ, before, after))
    return before != after


def quantity_names(log: RecordReader, step: int) -> Iterator[str]:
    """Yield the names that may complete an expression at a step."""
    state = state_at(log, step)
    yield from (f"{each}(" for each in ("holding", "distance", "upright"))
    for world in state.worlds.values():
        yield written(world.name)
        for body in world.bodies.values():
            name = written(body.name)
            yield name
            yield from (f"{name}.{part}" for part in PARTS)
            yield from (f"{name}.{joint}" for joint in body.joints)
