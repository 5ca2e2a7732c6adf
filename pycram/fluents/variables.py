"""Variables: leaves that are set, by a plan or by changes of a world; each assignment is recorded."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from pycram.fluents.expressions import Ended, Leaf, lock, notify
from pycram.fluents.pulses import counters_on, pulse
from recorder import records
from recorder.tracing import journal, span
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from pycram.fluents.expressions import Expression, Value

_numbers = itertools.count(1)


class Variable(Leaf):
    """A value that is set.

    Attributes:
        name: Its name.
        source: What it follows in a world ("pose", "joint", ...), for the record; "" if it is set by the plan.
        bodies: Names of the objects that it follows.
        json: Its value as JSON, for the record; None if that isn't known.
    """

    __slots__ = ("bodies", "json", "name", "source")

    def __init__(self, value: Value, name: str | None = None, source: str = "", bodies: tuple[str, ...] = ()) -> None:
        super().__init__((), value)
        self.name = f"fluent_{next(_numbers)}" if name is None else name
        self.source = source
        self.bodies = bodies
        self.json: str | None = None

    def text(self, depth: int = 0) -> str:  # noqa: ARG002  names have no depth
        """Return its name."""
        return self.name

    def serialize(self) -> None:
        """Convert its value to JSON; never with a lock held, as the value may have a conversion of its own."""
        if self.json is None and not isinstance(self.held, Ended):
            held = self.held
            json = records.to_json(held)
            with lock:
                if self.held is held:
                    self.json = json

    def record(self, after: str) -> records.Fluent:
        """Return the record of its next value, given as JSON."""
        return records.Fluent(
            name=self.name, before_json=self.json or "", after_json=after, source=self.source, bodies=self.bodies
        )


def assign(values: Mapping[Variable, Value], world: str = "", sim_step: int = 0) -> None:
    """Give variables new values, all at the same moment, record that, and pulse them.

    Args:
        values: The new values.
        world: Name of the world that they follow.
        sim_step: Simulated steps of that world when they changed.

    Raises:
        RecordingError: A change can't be recorded; it isn't made then.
    """
    serialized: dict[Variable, str] = {}
    if journal.recording():
        for variable, value in values.items():
            variable.serialize()
            serialized[variable] = records.to_json(value)
    with Uninterrupted():
        old = []  # freed after the lock is released
        with lock:
            for variable, json in serialized.items():
                span.emit(variable.record(json), world=world, sim_step=sim_step)
            for variable, value in values.items():
                old.append(variable.held)
                variable.held, variable.json = value, serialized.get(variable)
            pulse(values)


def pulse_unchanged(expression: Expression) -> None:
    """Pulse an expression without changing any value; recorded as an assignment of the same value.

    Raises:
        RecordingError: It can't be recorded; nothing is pulsed then.
    """
    record = None
    if journal.recording():
        if isinstance(expression, Variable):
            expression.serialize()
        record = (
            expression.record(expression.json or "")
            if isinstance(expression, Variable)
            else records.Fluent(name=expression.text())
        )
    with Uninterrupted(), lock:
        if record is not None:
            record.before_json = record.after_json
            span.emit(record)
        pulse((expression,))


def end(leaves: Collection[Leaf], ended: Ended) -> None:
    """End leaves: their values can't be read any more, and waiting for them ends with an error."""
    with lock:
        all_ended = (*leaves, *counters_on(leaves))
        for leaf in all_ended:
            leaf.held = ended
        notify(all_ended)
