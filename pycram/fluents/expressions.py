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

import reprlib
from abc import ABC, abstractmethod
from operator import methodcaller
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeAlias

from pycram.foundation.failures import WorldClosed
from pycram.scheduling.locks import shared_lock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from weakref import WeakValueDictionary

    from pycram.fluents.pulses import PulseCounter

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
