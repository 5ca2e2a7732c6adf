"""Terms: what the value of a fluent comes from.

Leaves hold what can change: a variable its value, an account the pulses that nobody has handled. Operations hold
nothing; their value is worked out from a state, the values of all their leaves at one moment. So a network never shows
a mix that never was, and always fits its operands.

Who knows whom: an operation its operands, an account the term whose pulses it counts; never the other way round, but
for weak references. What is dropped is gone.

One lock guards all leaves of the process, for the few assignments of a change. With it held no user code runs: no
function of a network, no ``__eq__``, no conversion to JSON, no finalizer of an old value. It comes after a world's lock
and before a journal's, so the order of the log is the order of the changes. It is re-entrant, since the garbage
collector may run finalizers anywhere, and they may set fluents.
"""

from __future__ import annotations

import reprlib
from abc import ABC, abstractmethod
from operator import methodcaller
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeAlias

from pycram.foundation.failures import WorldClosed
from pycram.scheduling.locks import Lock

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator

    from pycram.fluents.pulses import Account

#: What fluents hold is whatever the plan gives.
Value: TypeAlias = Any
#: Values of leaves at one moment; operations put theirs beside, so that each is worked out once.
State: TypeAlias = dict["Term", Value]

lock: Final = Lock()
_DEEPEST: Final = 4  # operations within each other that a name spells out
_HIGHEST: Final = 100  # operations within each other that are worked out by calls within each other


class Ended(NamedTuple):
    """Stands in a leaf for the value that it can't have any more.

    Attributes:
        world: name of the world that it followed.
        what: what is gone, in words.
    """

    world: str
    what: str


class Watcher(Protocol):
    """Somebody who is told of every change of the leaves at which it is registered."""

    def see(self) -> None:
        """Something changed; called with the lock held."""


class Term(ABC):
    """Something with a value.

    Attributes:
        operands: what its value is worked out from.
        accounts: those that count its pulses.
        watchers: those who are told when it changes; only leaves have any.
    """

    __slots__ = ("__weakref__", "accounts", "operands")

    watchers: Iterable[Watcher] = ()

    def __init__(self, operands: tuple[Term, ...]) -> None:
        self.operands = operands
        self.accounts: Collection[Account] = ()

    @property
    @abstractmethod
    def leaves(self) -> tuple[Leaf, ...]:
        """The leaves below it, each once; a leaf itself."""

    @abstractmethod
    def value(self, state: State) -> Value:
        """Its value, given those of its leaves.

        Raises:
            WorldClosed: something that it follows is gone.
            Exception: what a function of the network raised.
        """

    @abstractmethod
    def text(self, depth: int = 0) -> str:
        """What people call it.

        Args:
            depth: of operations around it.
        """

    def state(self) -> State:
        """The values of its leaves now, all at the same moment."""
        with lock:
            return {leaf: leaf.held for leaf in self.leaves}


class Leaf(Term):
    """A term that holds something.

    Attributes:
        held: its value, or that it has ended.
        watchers: those who are told when it changes.
    """

    __slots__ = ("held", "watchers")

    def __init__(self, operands: tuple[Term, ...], held: Value) -> None:
        super().__init__(operands)
        self.held = held
        self.watchers: list[Watcher] = []

    @property
    def leaves(self) -> tuple[Leaf, ...]:
        """Itself; not kept, as what refers to itself is gone only when the garbage collector has found it."""
        return (self,)

    def value(self, state: State) -> Value:
        """Its value in that state."""
        held = state[self]
        if isinstance(held, Ended):
            raise WorldClosed(held.world, f"follow {self.text()}", held.what)
        return held


class Constant(Term):
    """A plain value among the operands of an operation."""

    __slots__ = ("_value",)

    leaves = ()

    def __init__(self, value: Value) -> None:
        super().__init__(())
        self._value = value

    def value(self, state: State) -> Value:  # noqa: ARG002  it is the same in all
        """The value."""
        return self._value

    def text(self, depth: int = 0) -> str:  # noqa: ARG002  as above
        """The value, shortened."""
        return reprlib.repr(self._value)


class Operation(Term):
    """A function of other terms' values.

    Attributes:
        function: takes an iterator over the operands' values, which works out those only that are asked for.
        form: its text, with ``{}`` for each operand.
        height: how many operations lie below each other from here down.
    """

    __slots__ = ("form", "function", "height", "leaves")

    leaves: tuple[Leaf, ...]

    def __init__(self, form: str, function: Callable[[Iterator[Value]], Value], operands: tuple[Term, ...]) -> None:
        super().__init__(operands)
        self.leaves = tuple(dict.fromkeys(leaf for operand in operands for leaf in operand.leaves))
        self.form = form
        self.function = function
        self.height: int = 1 + max((one.height for one in operands if isinstance(one, Operation)), default=0)

    def value(self, state: State) -> Value:
        """What the function makes of the operands' values."""
        if self not in state:
            if self.height > _HIGHEST:
                return self._value_from_below(state)
            state[self] = self.function(map(methodcaller("value", state), self.operands))
        return state[self]

    def _value_from_below(self, state: State) -> Value:
        """The same without calls within each other: a function that lacks an operand's value is asked again later."""
        asked: list[Operation] = [self]
        while asked:
            one = asked[-1]
            try:
                state[one] = one.function(_at_hand(operand, state) for operand in one.operands)
                asked.pop()
            except _Lacking as lacking:
                asked.append(lacking.operation)
        return state[self]

    def text(self, depth: int = 0) -> str:
        """The operation spelt out, in parentheses inside of another, and cut off where it is too deep to be read."""
        if depth > _DEEPEST:
            return "..."
        told = self.form.format(*(operand.text(depth + 1) for operand in self.operands))
        return f"({told})" if depth and self.form.startswith(("{} ", "NOT ", "-", "+")) else told


class _Lacking(BaseException):
    """A function asks for the value of an operation that is too high to be worked out within it."""

    def __init__(self, operation: Operation) -> None:
        super().__init__()
        self.operation = operation


def _at_hand(operand: Term, state: State) -> Value:
    if isinstance(operand, Operation) and operand.height > _HIGHEST and operand not in state:
        raise _Lacking(operand)
    return operand.value(state)


def wake(changed: Iterable[Term]) -> None:
    """Tells those who watch these terms, each once, that something changed; the lock is held."""
    for watcher in dict.fromkeys(watcher for term in changed for watcher in term.watchers):
        watcher.see()
