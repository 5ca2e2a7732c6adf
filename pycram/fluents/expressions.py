"""Expressions: the variables, pulse counters and operations behind fluents.

A state has the values of all leaves (variables and counters of unhandled pulses) at one moment. An operation computes
its value from one state. One re-entrant lock guards all leaves of the process. While a thread holds the lock, no user
code runs: no function of a network, no ``__eq__``, no conversion to JSON, no finalizer of an old value.
"""

from __future__ import annotations

import itertools
import reprlib
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from enum import Enum
from operator import methodcaller
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias, cast
from weakref import WeakValueDictionary

from pycram.foundation.failures import WorldClosed
from pycram.scheduling.schedule import Lock
from recorder import records
from recorder.tracing import journal, span
from recorder.tracing.context import current_name
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from pycram.fluents.fluent import StateStream
    from pycram.scheduling.cancellation import Clock

Value: TypeAlias = Any  # any value of a fluent
#: Values of leaves at one moment. Each operation adds its own value, so it computes the value only once.
State: TypeAlias = dict["Expression", Value]

lock: Final = Lock()
_MAX_NAME_DEPTH: Final = 4  # maximum number of nested operations in a name


class Ended(NamedTuple):
    """Replaces the value of a leaf when the followed object or world is gone."""

    world: str  # name of the world
    what: str  # the object or world that is gone, for messages


class Expression(ABC):
    """An expression with a value."""

    __slots__ = ("__weakref__", "counters", "operands")

    waiters: Iterable[StateStream] = ()
    """The streams that changes notify; only leaves have streams."""

    def __init__(self, operands: tuple[Expression, ...]) -> None:
        self.operands = operands  # the expressions from which the value is computed
        #: Counters of this expression's pulses by their id(); None before the first counter.
        self.counters: WeakValueDictionary[int, PulseCounter] | None = None

    @property
    @abstractmethod
    def leaves(self) -> tuple[Leaf, ...]:
        """All leaves below this expression, each once; a leaf has only itself."""

    @abstractmethod
    def value(self, state: State) -> Value:
        """Return the value in a state. Raise WorldClosed if a followed object is gone, or the error of a function."""

    @abstractmethod
    def text(self, depth: int = 0) -> str:
        """Return the expression's name when it is an operand at a ``depth`` of nested operations."""

    def variables(self) -> Iterator[Variable]:
        """Yield all variables that determine the value, also variables behind counters."""
        leaves: list[Expression] = [*self.leaves]
        for leaf in leaves:  # the loop appends to the list that it iterates over
            if isinstance(leaf, Variable):
                yield leaf
            for operand in leaf.operands:
                leaves.extend(operand.leaves)

    def state(self) -> State:
        """Return the values of all leaves at the present moment."""
        with lock:
            return {leaf: leaf.held for leaf in self.leaves}


class Leaf(Expression):
    """An expression that holds a value."""

    __slots__ = ("held", "waiters")

    def __init__(self, operands: tuple[Expression, ...], held: Value) -> None:
        super().__init__(operands)
        self.held = held  # the value, or Ended when the followed object is gone
        self.waiters: list[StateStream] = []

    @property
    def leaves(self) -> tuple[Leaf, ...]:
        """The leaf itself. This is a property, because a stored reference would delay the freeing of the expression."""
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

    def text(self, depth: int = 0) -> str:  # noqa: ARG002  constants have no parentheses
        """Return the name."""
        return reprlib.repr(self._value)


class Operation(Expression):
    """An expression that applies a function to the values of other expressions."""

    __slots__ = ("form", "function", "leaves")

    leaves: tuple[Leaf, ...]

    def __init__(
        self, form: str, function: Callable[[Iterator[Value]], Value], operands: tuple[Expression, ...]
    ) -> None:
        super().__init__(operands)
        self.leaves = tuple(dict.fromkeys(leaf for operand in operands for leaf in operand.leaves))
        self.form = form  # the name, with ``{}`` in place of each operand
        self.function = function  # the function gets an iterator that computes the operands' values on demand

    def value(self, state: State) -> Value:
        """Return the value in a state."""
        if self not in state:
            state[self] = self.function(map(methodcaller("value", state), self.operands))
        return state[self]

    def text(self, depth: int = 0) -> str:
        """Return the name, in parentheses for an operand; "..." for an operand that is nested too deeply."""
        if depth > _MAX_NAME_DEPTH:
            return "..."
        text = self.form.format(*(operand.text(depth + 1) for operand in self.operands))
        return f"({text})" if depth and self.form.startswith(("{} ", "NOT ", "-", "+")) else text


def notify(changed: Iterable[Expression]) -> None:
    """Notify each stream of the changed expressions once; the caller holds the lock."""
    for waiter in dict.fromkeys([waiter for expression in changed for waiter in expression.waiters]):
        waiter.state_changed()


class Behavior(Enum):
    """How ``whenever`` handles pulses that come while its body still handles an earlier pulse."""

    NEVER = 1
    """Ignore the pulses."""
    ONCE = 2
    """Run the body once for all pulses together."""
    ALWAYS = 3
    """Run the body once for each pulse."""


class _Seen:
    """A state whose pulses are counted later, because no function of a network may run during a change."""

    def __init__(self, state: State, before: _Seen | None) -> None:
        self.state: State | None = state  # set to None when the number of pulses is computed
        self.before = before
        self.value: Value = None
        self.count = 0  # number of pulses up to this state

    def read(self, of: Expression, is_pulse: Callable[[Value, Value], bool]) -> int:
        """Return the number of pulses up to this state. Each error of a network's function is raised once."""
        unread = [self]
        while (before := unread[-1].before) is not None and before.state is not None:
            unread.append(before)
        for seen in reversed(unread):
            state, before = seen.state, seen.before  # read each attribute once, because another thread may clear both
            if state is None:
                continue
            # if a function of the network fails, these results are kept; the function may succeed in the next state
            value, count = (None, 0) if before is None else (before.value, before.count)
            try:
                now = of.value(state)
                value, count = now, 0 if before is None else before.count + is_pulse(before.value, now)
            finally:
                seen.value, seen.count = value, count
                seen.state = seen.before = None
        return self.count


class Pulses(NamedTuple):
    """Value of a counter: the number of its unhandled pulses, except pulses of states that no thread has read yet."""

    direct: int
    seen: _Seen | None


def changes(before: Value, after: Value) -> bool:
    """Return whether the value ``after`` a change differs from the value ``before`` it."""
    if before is after:
        return False
    try:
        return bool(before != after)
    except ValueError:  # arrays are compared element by element
        return True


def rises(before: Value, after: Value) -> bool:
    """Return whether a value becomes true."""
    return not before and bool(after)


def falls(before: Value, after: Value) -> bool:
    """Return whether a value stops being true."""
    return bool(before) and not after


class PulseCounter(Leaf):
    """Counts the unhandled pulses of an expression; its value is True while a pulse is unhandled, else None.

    ``is_pulse`` (:func:`changes`, :func:`rises` or :func:`falls`) returns whether a change of the value is a pulse. By
    default, each assignment to a variable is a pulse, and each change of a network's value.
    """

    __slots__ = ("is_pulse", "kind", "missed")

    def __init__(
        self, of: Expression, missed: Behavior, is_pulse: Callable[[Value, Value], bool] | None = None
    ) -> None:
        self.missed = missed
        self.kind = "pulsed" if is_pulse is None else _METHODS[is_pulse]
        counted = isinstance(of, Variable) or (isinstance(of, PulseCounter) and of.is_pulse is None)
        #: None if every change is a pulse; then no values are compared.
        self.is_pulse: Callable[[Value, Value], bool] | None = changes if is_pulse is None and not counted else is_pulse
        with lock:
            super().__init__((of,), Pulses(0, None if self.is_pulse is None else _Seen(of.state(), None)))
            for expression in _reachable((of,), lambda each: () if isinstance(each, PulseCounter) else each.operands):
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
        """Count a pulse, or keep the new state to find pulses later; the caller holds the lock."""
        direct, seen = self.held
        if self.is_pulse is None or (without_change and self.kind == "pulsed"):
            self.held = Pulses(direct + 1, seen)
        elif not without_change:
            self.held = Pulses(direct, _Seen({leaf: leaf.held for leaf in self.operands[0].leaves}, seen))

    def take(self) -> None:
        """Mark one unhandled pulse, if there is one, as handled."""
        self._handle(lambda count: min(count, 1))

    def settle(self) -> None:
        """Finish handling a pulse. Drop later pulses if the behavior demands it."""
        if self.missed is not Behavior.ALWAYS:
            kept = 1 if self.missed is Behavior.ONCE else 0
            self._handle(lambda count: max(count - kept, 0))

    def _count(self, held: Pulses) -> int:
        return held.direct + (0 if held.seen is None else held.seen.read(self.operands[0], self.is_pulse or changes))

    def _handle(self, handled: Callable[[int], int]) -> None:
        held = self.held
        if not isinstance(held, Ended):
            number = handled(self._count(held))  # outside the lock, because functions of the plan may run
            with lock:
                if not isinstance(self.held, Ended):
                    self.held = self.held._replace(direct=self.held.direct - number)
                    notify((self,))


#: The methods of fluents that make counters, by the kind of pulses.
_METHODS: Final[dict[object, str]] = {changes: "changed", rises: "rising", falls: "falling"}


def _reachable(given: Iterable[Expression], next_to: Callable[[Expression], Iterable[Expression]]) -> list[Expression]:
    """Return the given distinct expressions, then all expressions that depend on them, each once."""
    queue = list(given)
    reached = set(queue)
    for expression in queue:
        for each in next_to(expression):
            if each not in reached:
                reached.add(each)
                queue.append(each)
    return queue


def _counters(expression: Expression) -> Collection[PulseCounter]:
    references = () if expression.counters is None else expression.counters.valuerefs()
    return [counter for reference in references if (counter := reference()) is not None]


def counters_on(pulsed: Collection[Expression]) -> list[PulseCounter]:
    """Return the counters of these expressions' pulses, and the counters of those counters' pulses, each once."""
    return cast("list[PulseCounter]", _reachable(pulsed, _counters)[len(pulsed) :])


def pulse(pulsed: Collection[Expression], *, without_change: bool = False) -> None:
    """Count one pulse in every counter of these expressions, and notify streams; the caller holds the lock."""
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
        self.source = source  # the followed quantity of a world ("pose", "joint", ...); "" if a plan sets the variable
        self.bodies = bodies  # names of the followed objects
        self.json: str | None = None  # the value as JSON for records; None if it isn't known
        self.set_by = ""  # name of the branch or thread that set the value last; "" before the first setting

    def text(self, depth: int = 0) -> str:  # noqa: ARG002  names of variables have no parentheses
        """Return the name."""
        return self.name

    def clock(self) -> Clock | None:
        """Return the clock that runs during waits for the variable; None if time doesn't change the value."""
        return None

    def serialize(self) -> None:
        """Convert the value to JSON. The caller holds no lock, because the conversion may be user code."""
        if self.json is None and not isinstance(self.held, Ended):
            held = self.held
            json = records.to_json(held)
            with lock:
                if self.held is held:
                    self.json = json

    def record(self, after: str) -> records.Fluent:
        """Return the record of an assignment; ``after`` is the new value as JSON."""
        return records.Fluent(
            name=self.name, before_json=self.json or "", after_json=after, source=self.source, bodies=self.bodies
        )


def assign(values: Mapping[Variable, Value], world: str = "", sim_step: int = 0) -> None:
    """Set variables at the same moment, record the changes, and pulse the variables.

    ``world`` is the world that the variables follow, with its number of simulated steps. If the recording fails,
    RecordingError is raised, and no variable is set.
    """
    name = current_name()
    serialized: dict[Variable, str] = {}
    if journal.recording():
        for variable, value in values.items():
            variable.serialize()
            serialized[variable] = records.to_json(value)
    with Uninterrupted():
        old = []  # frees the old values after the release of the lock
        with lock:
            for variable, json in serialized.items():
                span.emit(variable.record(json), world=world, sim_step=sim_step)
            for variable, value in values.items():
                old.append(variable.held)
                variable.held, variable.json = value, serialized.get(variable)
                variable.set_by = name
            pulse(values)


def pulse_unchanged(expression: Expression) -> None:
    """Pulse an expression without changing its value; the record is an assignment of the same value."""
    record = None
    if journal.recording():
        record = records.Fluent(name=expression.text())
        if isinstance(expression, Variable):
            expression.serialize()
            record = expression.record(expression.json or "")
    with Uninterrupted(), lock:
        if record is not None:
            record.before_json = record.after_json
            span.emit(record)
        pulse((expression,), without_change=True)


def end(leaves: Collection[Leaf], ended: Ended) -> None:
    """Mark leaves as ended: from now on, reading or awaiting them raises WorldClosed."""
    with lock:
        all_ended = (*leaves, *counters_on(leaves))
        for leaf in all_ended:
            leaf.held = ended
        notify(all_ended)
