"""Variables: the leaves that are set, by a plan or by what happens in a world; each change is a record."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from pycram.fluents.expressions import Ended, Leaf, lock, wake
from pycram.fluents.pulses import accounts_on, pulse
from recorder import records
from recorder.tracing import journal
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from pycram.fluents.expressions import Term, Value

_numbers = itertools.count(1)


class Variable(Leaf):
    """A value that is set.

    Attributes:
        name: what it is called.
        source: what of a world it follows, for the record.
        bodies: names of the objects whose it is.
    """

    __slots__ = ("bodies", "json", "name", "source")

    def __init__(self, value: Value, name: str | None = None, source: str = "", bodies: tuple[str, ...] = ()) -> None:
        super().__init__((), value)
        self.name = f"fluent_{next(_numbers)}" if name is None else name
        self.source = source
        self.bodies = bodies
        self.json: str | None = None

    def text(self, depth: int = 0) -> str:  # noqa: ARG002  names have no depth
        """Its name."""
        return self.name

    def tell(self) -> None:
        """Makes sure that its value is known as JSON; never with a lock held, as the value says itself what it is."""
        if self.json is None and not isinstance(self.held, Ended):
            held = self.held
            json = records.to_json(held)
            with lock:
                if self.held is held:
                    self.json = json

    def record(self, after: str) -> records.Fluent:
        """The record of its next value.

        Args:
            after: that value as JSON.
        """
        return records.Fluent(
            name=self.name, before_json=self.json or "", after_json=after, source=self.source, bodies=self.bodies
        )


def change(news: Mapping[Variable, Value], world: str = "", sim_step: int = 0) -> None:
    """Gives variables new values, all at the same moment, records that, and pulses them.

    Args:
        news: the new values.
        world: name of the world that they follow.
        sim_step: simulated steps of that world when they became so.

    Raises:
        RecordingError: a change can't be recorded; it isn't made then.
    """
    told: dict[Variable, str] = {}
    if journal.recording():
        for variable, value in news.items():
            variable.tell()
            told[variable] = records.to_json(value)
    with Uninterrupted():
        old = []  # kept until the lock is free
        with lock:
            for variable, json in told.items():
                journal.emit(variable.record(json), world=world, sim_step=sim_step)
            for variable, value in news.items():
                old.append(variable.held)
                variable.held, variable.json = value, told.get(variable)
            pulse(news)


def touch(term: Term) -> None:
    """Pulses a term without changing any value; on record as a change to the same.

    Args:
        term: any.

    Raises:
        RecordingError: it can't be recorded; nothing is pulsed then.
    """
    record = None
    if journal.recording():
        if isinstance(term, Variable):
            term.tell()
        record = term.record(term.json or "") if isinstance(term, Variable) else records.Fluent(name=term.text())
    with Uninterrupted(), lock:
        if record is not None:
            record.before_json = record.after_json
            journal.emit(record)
        pulse((term,))


def end(leaves: Collection[Leaf], ended: Ended) -> None:
    """Ends leaves: whoever asks for their values or waits for them is told that they are gone.

    Args:
        leaves: the leaves.
        ended: what is gone.
    """
    with lock:
        all_ended = (*leaves, *accounts_on(leaves))
        for leaf in all_ended:
            leaf.held = ended
        wake(all_ended)
