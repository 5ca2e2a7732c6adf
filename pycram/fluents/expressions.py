"""Expressions: the variables, pulse counters and operations behind fluents.

Leaves hold values: a variable its value, a counter the number of its unhandled pulses. The value of an operation is
computed from a state, the values of all its leaves at one moment, so it never mixes two moments. Operations refer to
their operands, and counters to their expression; references in the other direction are weak, so unused networks are
freed.

A pulse means that something happened to a fluent, whether or not its value changed. It pulses all expressions that have
the fluent's expression as an operand. A change counts once, however many paths lead from it to a counter.

One lock guards all leaves of the process, for the few assignments of a change. While it is held, no user code runs: no
function of a network, no ``__eq__``, no conversion to JSON, no finalizer of an old value. It is acquired after a
world's lock and before a journal's, so the order of records is the order of changes. It is re-entrant, because the
garbage collector may run finalizers anywhere, and they may set fluents.
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
from pycram.scheduling.schedule import shared_lock
from recorder import records
from recorder.tracing import journal, span
from recorder.tracing.context import current_name
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from weakref import WeakValueDictionary

    from pycram.scheduling.strikes import Clock


#: Any value that a plan gives to a fluent.
Value: TypeAlias = Any
#: Values of leaves at one moment; operations add their values, so that each is computed once.
State: TypeAlias = dict["Expression", Value]

lock: Final = shared_lock()
_MAX_NAME_DEPTH: Final = 4  # nested operations that a name spells out
_MAX_RECURSION: Final = 100  # nested operations that are computed by recursive calls


class Ended(NamedTuple):
    """Held by a leaf instead of a value when the object or world that it followed is gone."""

    world: str  # name of the world
    what: str  # the object or world that is gone, for messages


class LeafListener(Protocol):
    """Registered at leaves, and notified of all their changes."""

    def state_changed(self) -> None:
        """Handle a change; called with the lock held."""


class Expression(ABC):
    """An expression with a value."""

    __slots__ = ("__weakref__", "counters", "operands")

    waiters: Iterable[LeafListener] = ()
    """The waiters that changes notify; only leaves have waiters."""

    def __init__(self, operands: tuple[Expression, ...]) -> None:
        self.operands = operands  # the expressions from which the value is computed
        #: Counters of the expression's pulses by their ids; None before the first.
        self.counters: WeakValueDictionary[int, PulseCounter] | None = None

    @property
    @abstractmethod
    def leaves(self) -> tuple[Leaf, ...]:
        """The leaves among the operands, at any depth, each once; for a leaf, the leaf itself."""

    @abstractmethod
    def value(self, state: State) -> Value:
        """Return the value in a state.

        Raises:
            WorldClosed: An object or world that the expression follows is gone.
            Exception: Any error of a function of the network.
        """

    @abstractmethod
    def text(self, depth: int = 0) -> str:
        """Return the expression's name, inside of ``depth`` operations."""

    def variables(self) -> Iterator[Variable]:
        """Yield the variables from which the value follows, also through counters."""
        leaves: list[Expression] = [*self.leaves]
        for leaf in leaves:  # the loop appends to it
            if isinstance(leaf, Variable):
                yield leaf
            for operand in leaf.operands:
                leaves.extend(operand.leaves)

    def state(self) -> State:
        """Return the present values of the leaves, all of the same moment."""
        with lock:
            return {leaf: leaf.held for leaf in self.leaves}


class Leaf(Expression):
    """An expression that holds a value."""

    __slots__ = ("held", "waiters")

    def __init__(self, operands: tuple[Expression, ...], held: Value) -> None:
        super().__init__(operands)
        self.held = held  # a value, or Ended
        self.waiters: list[LeafListener] = []

    @property
    def leaves(self) -> tuple[Leaf, ...]:
        """The leaf itself; not stored, because a reference to itself would delay its freeing."""
        return (self,)

    def value(self, state: State) -> Value:
        """Return the value in a state."""
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

    def value(self, state: State) -> Value:  # noqa: ARG002  the value is constant
        """Return the value in a state."""
        return self._value

    def text(self, depth: int = 0) -> str:  # noqa: ARG002  as above
        """Return the name."""
        return reprlib.repr(self._value)


class Operation(Expression):
    """A function of the values of other expressions."""

    __slots__ = ("form", "function", "height", "leaves")

    leaves: tuple[Leaf, ...]

    def __init__(
        self, form: str, function: Callable[[Iterator[Value]], Value], operands: tuple[Expression, ...]
    ) -> None:
        super().__init__(operands)
        self.leaves = tuple(dict.fromkeys(leaf for operand in operands for leaf in operand.leaves))
        self.form = form  # the name, with ``{}`` for each operand
        self.function = function  # takes an iterator over the operands' values, which computes them on demand
        #: Number of nested operations, this one included.
        self.height: int = 1 + max(
            (operand.height for operand in operands if isinstance(operand, Operation)), default=0
        )

    def value(self, state: State) -> Value:
        """Return the value in a state."""
        if self not in state:
            if self.height > _MAX_RECURSION:
                return self._value_iteratively(state)
            state[self] = self.function(map(methodcaller("value", state), self.operands))
        return state[self]

    def _value_iteratively(self, state: State) -> Value:
        """Compute the value without recursion: a function that needs an unknown operand is called again later."""
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
        """Return the name, in parentheses inside of another operation; cut off if it is nested too deep."""
        if depth > _MAX_NAME_DEPTH:
            return "..."
        text = self.form.format(*(operand.text(depth + 1) for operand in self.operands))
        return f"({text})" if depth and self.form.startswith(("{} ", "NOT ", "-", "+")) else text


class _NotComputed(BaseException):
    """A function needs the value of an operation that is nested too deep to be computed recursively."""

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
    """How ``whenever`` handles pulses that come while its body handles an earlier pulse."""

    NEVER = 1
    """The pulses are ignored."""
    ONCE = 2
    """The body runs once more for all of the pulses."""
    ALWAYS = 3
    """The body runs once more for each of the pulses."""


class _Seen:
    """A state that a counter of changes has seen, after an earlier one.

    Its pulses are counted when they are read, because the functions of networks never run while a fluent changes.
    """

    __slots__ = ("before", "count", "state", "value")

    def __init__(self, state: State, before: _Seen | None) -> None:
        self.state: State | None = state  # None once the value is known
        self.before = before
        self.value: Value = None
        self.count = 0  # pulses up to here

    def read(self, of: Expression, is_pulse: Callable[[Value, Value], bool]) -> int:
        """Return the number of pulses up to this state; an error of a network's function is raised once."""
        unread = [self]
        while (before := unread[-1].before) is not None and before.state is not None:
            unread.append(before)
        for seen in reversed(unread):
            state, before = seen.state, seen.before  # once each: another thread may read them as well
            if state is None:
                continue
            # kept if the function of a network raises an error; it may succeed in the next state
            value, count = (None, 0) if before is None else (before.value, before.count)
            try:
                now = of.value(state)
                value, count = now, 0 if before is None else before.count + is_pulse(before.value, now)
            finally:
                seen.value, seen.count = value, count
                seen.state = seen.before = None
        return self.count


class Pulses(NamedTuple):
    """Value of a counter: the pulses counted directly minus the handled pulses, and states to read."""

    direct: int
    seen: _Seen | None


def changes(before: Value, after: Value) -> bool:
    """Whether a value differs from the value before."""
    if before is after:
        return False
    try:
        return bool(before != after)
    except ValueError:  # arrays, which compare element by element
        return True


def rises(before: Value, after: Value) -> bool:
    """Whether a value becomes true."""
    return not before and bool(after)


def falls(before: Value, after: Value) -> bool:
    """Whether a value stops being true."""
    return bool(before) and not after


class PulseCounter(Leaf):
    """Counts the unhandled pulses of an expression; its value is True while there are any, else None.

    Args:
        of: The expression.
        missed: How ``whenever`` handles pulses that come while it handles an earlier pulse.
        is_pulse: :func:`changes`, :func:`rises` or :func:`falls`: whether a new value is a pulse, given the old value.
            By default each assignment to a variable is a pulse, and each change of a network's own value.
    """

    __slots__ = ("is_pulse", "kind", "missed")

    def __init__(
        self, of: Expression, missed: Behavior, is_pulse: Callable[[Value, Value], bool] | None = None
    ) -> None:
        self.missed = missed
        self.kind = "pulsed" if is_pulse is None else _METHODS[is_pulse]
        counted = isinstance(of, Variable) or (isinstance(of, PulseCounter) and of.is_pulse is None)
        #: None if pulses are counted directly.
        self.is_pulse: Callable[[Value, Value], bool] | None = changes if is_pulse is None and not counted else is_pulse
        with lock:
            super().__init__((of,), Pulses(0, None if self.is_pulse is None else _Seen(of.state(), None)))
            for expression in _reachable(
                (of,), lambda below: () if isinstance(below, PulseCounter) else below.operands
            ):
                if expression.counters is None:
                    expression.counters = weakref.WeakValueDictionary()
                expression.counters[id(self)] = self

    def value(self, state: State) -> Value:
        """Return the value in a state."""
        return True if self._count(super().value(state)) > 0 else None

    def text(self, depth: int = 0) -> str:
        """Return the name."""
        return f"{self.operands[0].text(depth + 1)}.{self.kind}({self.missed.name})"

    def pulse(self, without_change: bool) -> None:
        """Count a pulse, or note the new state, which may be a pulse; the lock is held."""
        direct, seen = self.held
        if self.is_pulse is None or (without_change and self.kind == "pulsed"):
            self.held = Pulses(direct + 1, seen)
        elif not without_change:
            self.held = Pulses(direct, _Seen({leaf: leaf.held for leaf in self.operands[0].leaves}, seen))

    def take(self) -> None:
        """Start handling a pulse, if there is one."""
        self._handle(lambda count: min(count, 1))

    def settle(self) -> None:
        """Finish handling a pulse, and drop the pulses that came meanwhile, depending on the behavior."""
        if self.missed is not Behavior.ALWAYS:
            kept = 1 if self.missed is Behavior.ONCE else 0
            self._handle(lambda count: max(count - kept, 0))

    def _count(self, held: Pulses) -> int:
        return held.direct + (0 if held.seen is None else held.seen.read(self.operands[0], self.is_pulse or changes))

    def _handle(self, handled: Callable[[int], int]) -> None:
        held = self.held
        if not isinstance(held, Ended):
            number = handled(self._count(held))  # functions of the plan may run, so without the lock
            with lock:
                if not isinstance(self.held, Ended):
                    self.held = self.held._replace(direct=self.held.direct - number)
                    notify((self,))


#: Methods of fluents that make counters, by their pulses.
_METHODS: Final[dict[object, str]] = {changes: "changed", rises: "rising", falls: "falling"}


def _reachable(given: Iterable[Expression], next_to: Callable[[Expression], Iterable[Expression]]) -> list[Expression]:
    """Return the given expressions, which are distinct, and all expressions reachable from them, each once."""
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
    """Return the counters of pulses of these expressions, and the counters of pulses of these counters, each once."""
    return cast("list[PulseCounter]", _reachable(pulsed, _counters)[len(pulsed) :])


def pulse(pulsed: Collection[Expression], *, without_change: bool = False) -> None:
    """Count one pulse in every counter of these expressions, and notify waiters; the lock is held."""
    counters = [counter for counter in counters_on(pulsed) if not isinstance(counter.held, Ended)]
    for counter in counters:
        counter.pulse(without_change)
    notify((*pulsed, *counters))


_numbers = itertools.count(1)


class Variable(Leaf):
    """A value that a plan or a world sets; each assignment is recorded."""

    __slots__ = ("bodies", "json", "name", "set_by", "source")

    def __init__(self, value: Value, name: str | None = None, source: str = "", bodies: tuple[str, ...] = ()) -> None:
        super().__init__((), value)
        self.name = f"fluent_{next(_numbers)}" if name is None else name
        self.source = source  # the quantity of a world that it follows ("pose", "joint", ...); "" if a plan sets it
        self.bodies = bodies  # names of the objects that it follows
        self.json: str | None = None  # the value as JSON, for the record; None if unknown
        self.set_by = ""  # name of the branch or thread that set it last; "" if none did

    def text(self, depth: int = 0) -> str:  # noqa: ARG002  names have no depth
        """Return the name."""
        return self.name

    def clock(self) -> Clock | None:
        """Return the simulated time that waits for the variable let pass; None if time doesn't change it."""
        return None

    def serialize(self) -> None:
        """Convert the value to JSON; never with a lock held, because the value may have its own conversion."""
        if self.json is None and not isinstance(self.held, Ended):
            held = self.held
            json = records.to_json(held)
            with lock:
                if self.held is held:
                    self.json = json

    def record(self, after: str) -> records.Fluent:
        """Return the record of the next value, given as JSON."""
        return records.Fluent(
            name=self.name, before_json=self.json or "", after_json=after, source=self.source, bodies=self.bodies
        )


def assign(values: Mapping[Variable, Value], world: str = "", sim_step: int = 0) -> None:
    """Give variables new values at the same moment, record the changes, and pulse the variables.

    Args:
        world: Name of the world that the variables follow.
        sim_step: Simulated steps of that world at the change.

    Raises:
        RecordingError: A change can't be recorded, and isn't made.
    """
    name = current_name()
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
                variable.set_by = name
            pulse(values)


def pulse_unchanged(expression: Expression) -> None:
    """Pulse an expression without changing any value; recorded as an assignment of the same value.

    Raises:
        RecordingError: The pulse can't be recorded, and isn't made.
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
        pulse((expression,), without_change=True)


def end(leaves: Collection[Leaf], ended: Ended) -> None:
    """End leaves: reading them and waiting for them raises an error from now on."""
    with lock:
        all_ended = (*leaves, *counters_on(leaves))
        for leaf in all_ended:
            leaf.held = ended
        notify(all_ended)
