"""Expressions: where the value of a fluent comes from.

Leaves hold what can change: a variable its value, a pulse counter the pulses that aren't handled yet. Operations hold
nothing; their value is computed from a state, the values of all their leaves at one moment. So a network never shows a
mix of two moments, and always fits its operands.

An operation refers to its operands, a counter to the expression whose pulses it counts; only weak references lead the
other way, so that dropped networks are freed.

One lock guards all leaves of the process, for the few assignments of a change. While it is held no user code runs: no
function of a network, no ``__eq__``, no conversion to JSON, no finalizer of an old value. It is acquired after a
world's lock and before a journal's, so the order of the records is the order of the changes. It is re-entrant, since
the garbage collector may run finalizers anywhere, and they may set fluents.
"""

from __future__ import annotations

import itertools
import reprlib
import weakref
from abc import ABC, abstractmethod
from enum import Enum
from operator import methodcaller
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeAlias, cast

from pycram.foundation.failures import WorldClosed
from pycram.scheduling.locks import shared_lock
from recorder import records
from recorder.tracing import journal, span
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from weakref import WeakValueDictionary


#: Any value that a plan gives to a fluent.
Value: TypeAlias = Any
#: Values of leaves at one moment; operations add theirs, so that each is computed once.
State: TypeAlias = dict["Expression", Value]

lock: Final = shared_lock()
_MAX_NAME_DEPTH: Final = 4  # nested operations that a name spells out
_MAX_RECURSION: Final = 100  # nested operations that are computed by recursive calls


class Ended(NamedTuple):
    """What a leaf holds instead of a value when the object or world that it followed is gone.

    Attributes:
        world: Name of the world.
        what: What is gone, for messages.
    """

    world: str
    what: str


class Waiter(Protocol):
    """Registered at leaves to be notified of all their changes."""

    def state_changed(self) -> None:
        """Notice a change; called with the lock held."""


class Expression(ABC):
    """Something with a value.

    Attributes:
        operands: Expressions from which its value is computed.
        counters: Counters of its pulses by their ids; None before the first.
        waiters: Notified of its changes; only leaves have any.
    """

    __slots__ = ("__weakref__", "counters", "operands")

    waiters: Iterable[Waiter] = ()

    def __init__(self, operands: tuple[Expression, ...]) -> None:
        self.operands = operands
        self.counters: WeakValueDictionary[int, PulseCounter] | None = None

    @property
    @abstractmethod
    def leaves(self) -> tuple[Leaf, ...]:
        """The leaves among its operands, at any depth, each once; a leaf itself."""

    @abstractmethod
    def value(self, state: State) -> Value:
        """Return its value, given those of its leaves.

        Raises:
            WorldClosed: An object or world that it follows is gone.
            Exception: Of a function of the network.
        """

    @abstractmethod
    def text(self, depth: int = 0) -> str:
        """Return its name, within ``depth`` operations."""

    def state(self) -> State:
        """Return the present values of its leaves, all of the same moment."""
        with lock:
            return {leaf: leaf.held for leaf in self.leaves}


class Leaf(Expression):
    """An expression that holds something.

    Attributes:
        held: Its value, or Ended.
        waiters: Notified of its changes.
    """

    __slots__ = ("held", "waiters")

    def __init__(self, operands: tuple[Expression, ...], held: Value) -> None:
        super().__init__(operands)
        self.held = held
        self.waiters: list[Waiter] = []

    @property
    def leaves(self) -> tuple[Leaf, ...]:
        """Itself; not stored, as only the garbage collector would free what refers to itself."""
        return (self,)

    def value(self, state: State) -> Value:
        """Return its value in a state."""
        held = state[self]
        if isinstance(held, Ended):
            raise WorldClosed(held.world, f"follow {self.text()}", held.what)
        return held


class Constant(Expression):
    """A plain value as an operand."""

    __slots__ = ("_value",)

    leaves = ()

    def __init__(self, value: Value) -> None:
        super().__init__(())
        self._value = value

    def value(self, state: State) -> Value:  # noqa: ARG002  it is constant
        """Return the value."""
        return self._value

    def text(self, depth: int = 0) -> str:  # noqa: ARG002  as above
        """Return the value, shortened."""
        return reprlib.repr(self._value)


class Operation(Expression):
    """A function of other expressions' values.

    Attributes:
        function: Takes an iterator over the operands' values, which computes only those that are asked for.
        form: Its name, with ``{}`` for each operand.
        height: Number of nested operations, this one included.
    """

    __slots__ = ("form", "function", "height", "leaves")

    leaves: tuple[Leaf, ...]

    def __init__(
        self, form: str, function: Callable[[Iterator[Value]], Value], operands: tuple[Expression, ...]
    ) -> None:
        super().__init__(operands)
        self.leaves = tuple(dict.fromkeys(leaf for operand in operands for leaf in operand.leaves))
        self.form = form
        self.function = function
        self.height: int = 1 + max(
            (operand.height for operand in operands if isinstance(operand, Operation)), default=0
        )

    def value(self, state: State) -> Value:
        """Return what the function computes from the operands' values."""
        if self not in state:
            if self.height > _MAX_RECURSION:
                return self._value_iteratively(state)
            state[self] = self.function(map(methodcaller("value", state), self.operands))
        return state[self]

    def _value_iteratively(self, state: State) -> Value:
        """Compute it without recursion: a function that needs an operand's value is called again when that is there."""
        pending: list[Operation] = [self]
        while pending:
            operation = pending[-1]
            try:
                state[operation] = operation.function(_computed(operand, state) for operand in operation.operands)
                pending.pop()
            except _NotComputed as missing:
                pending.append(missing.operation)
        return state[self]

    def text(self, depth: int = 0) -> str:
        """Return the operation spelt out, in parentheses inside of another one, cut off where it is nested too deep."""
        if depth > _MAX_NAME_DEPTH:
            return "..."
        text = self.form.format(*(operand.text(depth + 1) for operand in self.operands))
        return f"({text})" if depth and self.form.startswith(("{} ", "NOT ", "-", "+")) else text


class _NotComputed(BaseException):
    """A function asks for the value of an operation that is nested too deep to be computed recursively."""

    def __init__(self, operation: Operation) -> None:
        super().__init__()
        self.operation = operation


def _computed(operand: Expression, state: State) -> Value:
    if isinstance(operand, Operation) and operand.height > _MAX_RECURSION and operand not in state:
        raise _NotComputed(operand)
    return operand.value(state)


def notify(changed: Iterable[Expression]) -> None:
    """Notify the waiters of these expressions, each once; the lock is held."""
    for waiter in dict.fromkeys([waiter for expression in changed for waiter in expression.waiters]):
        waiter.state_changed()


class Behavior(Enum):
    """What happens to pulses that come while the body of a ``whenever`` handles an earlier one."""

    NEVER = 1
    """They are ignored."""
    ONCE = 2
    """The body runs once more for all of them."""
    ALWAYS = 3
    """The body runs once more for each of them."""


class PulseCounter(Leaf):
    """Counts the pulses of an expression that aren't handled yet; its value is True while there are any, else None.

    Attributes:
        missed: What happens to pulses that come while an earlier one is handled.
    """

    __slots__ = ("missed",)

    def __init__(self, of: Expression, missed: Behavior) -> None:
        super().__init__((of,), 0)
        self.missed = missed
        with lock:
            for expression in _reachable(
                (of,), lambda below: () if isinstance(below, PulseCounter) else below.operands
            ):
                if expression.counters is None:
                    expression.counters = weakref.WeakValueDictionary()
                expression.counters[id(self)] = self

    def value(self, state: State) -> Value:
        """Return True if there are pulses to handle, else None."""
        return True if super().value(state) else None

    def text(self, depth: int = 0) -> str:
        """Return the name of its expression with ``.pulsed(...)``."""
        return f"{self.operands[0].text(depth + 1)}.pulsed({self.missed.name})"

    def take(self) -> None:
        """Begin to handle a pulse, if there is one."""
        self._change(lambda count: max(count - 1, 0))

    def settle(self) -> None:
        """End what :meth:`take` began: drop pulses that came meanwhile, as the behavior says."""
        if self.missed is not Behavior.ALWAYS:
            kept = 1 if self.missed is Behavior.ONCE else 0
            self._change(lambda count: min(count, kept))

    def _change(self, pulses: Callable[[int], int]) -> None:
        with lock:
            if not isinstance(self.held, Ended):
                self.held = pulses(self.held)
                notify((self,))


def _reachable(given: Iterable[Expression], next_to: Callable[[Expression], Iterable[Expression]]) -> list[Expression]:
    """Return the given expressions, which are different ones, and all that are next to them, or to those, each once."""
    queue = list(given)
    reached = set(queue)
    for expression in queue:
        for each in next_to(expression):
            if each not in reached:
                reached.add(each)
                queue.append(each)
    return queue


def _counters(expression: Expression) -> Collection[PulseCounter]:
    counters = expression.counters
    if counters is None:
        return ()
    return [counter for reference in counters.valuerefs() if (counter := reference()) is not None]


def counters_on(pulsed: Collection[Expression]) -> list[PulseCounter]:
    """Return the counters of pulses of these expressions, and those of pulses of these counters, each once."""
    return cast("list[PulseCounter]", _reachable(pulsed, _counters)[len(pulsed) :])


def pulse(pulsed: Collection[Expression]) -> None:
    """Count one pulse in every counter of these expressions, and notify waiters; the lock is held."""
    counters = [counter for counter in counters_on(pulsed) if not isinstance(counter.held, Ended)]
    for counter in counters:
        counter.held += 1
    notify((*pulsed, *counters))


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
