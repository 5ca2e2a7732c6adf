"""Fluents: values that the branches of a plan share, wait for and react to (thesis 3.5.3; docs/guides/fluents.md).

Operators make networks. Comparisons and AND, OR, NOT, IS, IS_NOT are True or None, never False, because waits end at a
value that is not None. Comparisons and sums with None are None. A wait misses no value, however short the value lasts:
a change only appends a new state, and the waiting thread computes the values of all states, without any lock held.
"""

from __future__ import annotations

import operator
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from typing import Final, Self, overload

from pycram.fluents.expressions import (
    Behavior,
    Constant,
    Ended,
    Expression,
    Operation,
    PulseCounter,
    State,
    Value,
    Variable,
    assign,
    changes,
    falls,
    lock,
    pulse_unchanged,
    rises,
)
from pycram.foundation import checks
from pycram.foundation.errors import export, qualified_name
from pycram.foundation.failures import BadArgument, UsageError
from pycram.foundation.refusals import refusing
from pycram.language.branch import lazy, run
from pycram.language.nesting import await_turn
from pycram.scheduling.cancellation import Deadline, checkpoint, raise_if_cancelled, wait_until
from pycram.scheduling.future import unwrap
from pycram.scheduling.schedule import Condition, scheduler
from recorder.tracing.span import current_call_stack, span

__all__ = ["Behavior", "FalseEndsWait", "Fluent", "NotSettable", "NotTrueOrFalse", "network"]

_MAX_NAME: Final = 60  # maximum length of a network's name in messages


class NotSettable(UsageError):
    """A plan set a fluent whose value follows a world or other fluents."""

    def __init__(self, fluent: str, of_world: bool) -> None:
        cause = "follows a world; change the world" if of_world else "is computed from other fluents; set these fluents"
        super().__init__(f"{fluent} can't be set: its value {cause}")
        self.fluent = fluent  # name of the fluent
        self.of_world = of_world  # whether the fluent follows a world


class FalseEndsWait(RuntimeWarning):
    """A wait for a fluent ended immediately, because False is a value."""


class NotTrueOrFalse(UsageError):
    """A plan used a fluent as a condition, instead of its value."""

    def __init__(self, fluent: str) -> None:
        super().__init__(
            f"the fluent {fluent} is neither true nor false; use get_value(), and combine fluents with AND, OR, NOT"
        )
        self.fluent = fluent  # name of the fluent


def _order(sign: str, test: Callable[[Value, Value], object]) -> Callable[[Fluent, object], Fluent]:
    """Return the method for an order relation. The network that the method makes is None if an operand is None."""

    def compare(self: Fluent, other: object) -> Fluent:
        return _comparison(sign, lambda a, b: a is not None and b is not None and test(a, b), self, other)

    return compare


def _arithmetic(
    sign: str, function: Callable[[Value, Value], Value]
) -> tuple[Callable[[Fluent, object], Fluent], Callable[[Fluent, object], Fluent]]:
    """Return two methods for an arithmetic operator: one with the fluent on the left, one on the right."""

    def left(self: Fluent, other: object) -> Fluent:
        return _network(f"{{}} {sign} {{}}", _unless_none(function), self, other)

    def right(self: Fluent, other: object) -> Fluent:
        return _network(f"{{}} {sign} {{}}", _unless_none(function), other, self)

    return left, right


def _unless_none(function: Callable[..., Value]) -> Callable[[Iterator[Value]], Value]:
    """Return a function of the operands' values that returns None if one of them is None."""

    def compute(values: Iterator[Value]) -> Value:
        given = tuple(values)
        return None if any(value is None for value in given) else function(*given)

    return compute


class Fluent:
    """A value that branches share.

    Fluents are hashable: sets, dictionaries and lists can contain fluents, and ``in`` finds them by identity. If a list
    also contains other values, ``in`` raises NotTrueOrFalse; use ``any(value is fluent for value in values)`` there.

    Args:
        value: The first value; of a future, its result.
        name: Name in recordings; "fluent_1", "fluent_2", ... by default.

    Raises:
        BadArgument: The name isn't text, or the value is a function.
    """

    __slots__ = ("__weakref__", "expression")
    __array_ufunc__ = None  # operators of NumPy arrays call the methods of Fluent

    expression: Expression
    """The expression that computes or holds the value."""

    def __init__(self, value: Value = None, name: str | None = None) -> None:
        self.expression = Variable(_checked(value), None if name is None else checks.text("name", name))

    @property
    def name(self) -> str:
        """Name of the fluent; for a network, the text of its operation."""
        return self.expression.text()

    def __repr__(self) -> str:
        return f"Fluent({self.name})"

    def __record__(self) -> object:
        """Return the reference by which records name the fluent."""
        return {"fluent": self.name}

    def get_value(self) -> Value:
        """Return the present value.

        Raises:
            WorldClosed: An object or world that the fluent follows is gone.
            Exception: Any error of a function of the network.
        """
        return self.expression.value(self.expression.state())

    @refusing("fluent")
    def set_value(self, value: Value) -> None:
        """Set the value, pulse the fluent, and wake branches that wait for it; a future is replaced by its result.

        Raises:
            NotSettable: The fluent is a network, counts pulses or follows a world.
            BadArgument: The value is a function.
            RecordingError: The recording failed; the value didn't change.
        """
        if not isinstance(self.expression, Variable) or self.expression.source:
            raise NotSettable(self.name, isinstance(self.expression, Variable))
        assign({self.expression: _checked(value)})

    def wait_for(self, timeout: float | None = None) -> bool:
        """Wait until the value is not None; for a counter of pulses, until a pulse is unhandled.

        False and 0 are values: ``Fluent(False).wait_for()`` returns immediately, and warns. To wait for a true value,
        start with None, or wait for ``fluent == True``.

        Args:
            timeout: In seconds; None for no limit.

        Returns:
            True if the value is not None, or was not None at any moment during the wait; False after the timeout.

        Raises:
            BadArgument: The timeout isn't a number.
            Cancelled: The branch is cancelled.
            WorldClosed: An object or world that the fluent follows is gone.
            Exception: Any error of a function of the network.
        """
        limit = None if timeout is None else checks.number("timeout", timeout)
        await_turn()
        state = self.expression.state()
        if state.get(self.expression) is False:
            text = (
                f"{self.name} is False, which is a value, so wait_for() returns immediately; "
                f"to wait for a true value, wait for ({self.name} == True), or make None the first value"
            )
            warnings.warn_explicit(text, FalseEndsWait, *current_call_stack().line)
        values = {leaf.text(): held for leaf, held in state.items() if not isinstance(held, Ended)}
        with span("wait", self.name, values | ({} if limit is None else {"timeout": limit})) as task:
            task.result = happened = first_value(self.expression, limit) is not None
            if not happened:
                task.checkpoint = scheduler().checkpoints
            return happened

    def pulse(self) -> None:
        """Pulse the fluent without changing its value; raises RecordingError if that can't be recorded."""
        pulse_unchanged(self.expression)

    def pulsed(self, handle_missed: Behavior = Behavior.ONCE) -> Fluent:
        """Return a fluent that counts later pulses of this fluent: True while a pulse is unhandled, else None.

        Each ``whenever`` needs its own counter; two ``whenever`` with the same counter would share the pulses.

        Raises:
            BadArgument: ``handle_missed`` isn't a behavior.
        """
        return self._counted(handle_missed)

    def changed(self, handle_missed: Behavior = Behavior.ONCE) -> Fluent:
        """Return a fluent that counts the changes of the value, as :meth:`pulsed` counts pulses."""
        return self._counted(handle_missed, changes)

    def rising(self, handle_missed: Behavior = Behavior.ONCE) -> Fluent:
        """Return a fluent that counts how often the value becomes true; None, False, 0 and empty values aren't true.

        This loop runs its body each time that a condition becomes true::

            for _ in whenever((battery < 20).rising()):
                charge()
        """
        return self._counted(handle_missed, rises)

    def falling(self, handle_missed: Behavior = Behavior.ONCE) -> Fluent:
        """Return a fluent that counts how often the value stops being true; see :meth:`rising`."""
        return self._counted(handle_missed, falls)

    def _counted(self, handle_missed: Behavior, is_pulse: Callable[[Value, Value], bool] | None = None) -> Fluent:
        if not isinstance(handle_missed, Behavior):
            raise BadArgument("handle_missed", handle_missed, "Behavior.NEVER, ONCE or ALWAYS")
        return Derived(PulseCounter(self.expression, handle_missed, is_pulse))

    def AND(self, other: object) -> Fluent:  # noqa: N802  the original's name
        """True if both values are true, else None; ``other`` is read only if the fluent's value is true."""
        return _network("{} AND {}", lambda values: True if all(values) else None, self, other)

    def OR(self, other: object) -> Fluent:  # noqa: N802  the original's name
        """True if one of the values is true, else None; ``other`` is read only if the fluent's value isn't true."""
        return _network("{} OR {}", lambda values: True if any(values) else None, self, other)

    def NOT(self) -> Fluent:  # noqa: N802  the original's name
        """True if the value isn't true (None, False, 0 or empty), else None."""
        return _network("NOT {}", lambda values: None if any(values) else True, self)

    def IS(self, other: object) -> Fluent:  # noqa: N802  the original's name
        """True if both values are the same object, else None."""
        return _comparison("IS", operator.is_, self, other)

    def IS_NOT(self, other: object) -> Fluent:  # noqa: N802  the original's name
        """True if the two values are different objects, else None."""
        return _comparison("IS_NOT", operator.is_not, self, other)

    def __eq__(self, other: object) -> Fluent:  # type: ignore[override]  # returns a network
        return _comparison("==", operator.eq, self, other, same=self.is_same(other))

    def __ne__(self, other: object) -> Fluent:  # type: ignore[override]  # returns a network
        same = self.is_same(other)
        return _comparison("!=", operator.ne, self, other, same=None if same is None else not same)

    def __hash__(self) -> int:
        return hash(self.expression)

    def is_same(self, other: object) -> bool | None:
        """Return whether ``other`` is this fluent itself; None if ``other`` isn't a fluent."""
        return self.expression is other.expression if isinstance(other, Fluent) else None

    def __bool__(self) -> bool:
        raise NotTrueOrFalse(self.name)

    __lt__ = _order("<", operator.lt)
    __le__ = _order("<=", operator.le)
    __gt__ = _order(">", operator.gt)
    __ge__ = _order(">=", operator.ge)
    __add__, __radd__ = _arithmetic("+", operator.add)
    __sub__, __rsub__ = _arithmetic("-", operator.sub)
    __mul__, __rmul__ = _arithmetic("*", operator.mul)
    __truediv__, __rtruediv__ = _arithmetic("/", operator.truediv)
    __floordiv__, __rfloordiv__ = _arithmetic("//", operator.floordiv)
    __mod__, __rmod__ = _arithmetic("%", operator.mod)
    __pow__, __rpow__ = _arithmetic("**", operator.pow)

    def __neg__(self) -> Fluent:
        return _network("-{}", _unless_none(operator.neg), self)

    def __pos__(self) -> Fluent:
        return _network("+{}", _unless_none(operator.pos), self)

    def __abs__(self) -> Fluent:
        return _network("abs({})", _unless_none(abs), self)


class Derived(Fluent):
    """A fluent whose value is computed from other fluents or from a world."""

    __slots__ = ("_same",)

    def __init__(self, expression: Expression, *, same: bool | None = None) -> None:
        self.expression = expression
        self._same = same  # truth value of ``==`` and ``!=`` between fluents, for ``in``; None for other networks

    def __bool__(self) -> bool:
        if self._same is None:
            raise NotTrueOrFalse(self.name)
        return self._same


def network(function: Callable[..., Value], *operands: object) -> Fluent:
    """Return a fluent that computes its value by a function of other fluents' values at the same moment.

    Args:
        function: Called with one value for each operand, whenever the network's value is needed.

    Raises:
        BadArgument: The function isn't callable.
    """
    if not callable(function):
        raise BadArgument("function", function, "a function of the operands' values")
    form = f"{qualified_name(function).rpartition('.')[2]}({', '.join(['{}'] * len(operands))})"
    return _network(form, lambda values: function(*values), *operands)


def _checked(value: Value) -> Value:
    plain = unwrap(value)
    if callable(plain) and not isinstance(plain, type):
        raise BadArgument("value", plain, "a value; network(function, *fluents) makes a fluent of a function")
    return plain


def _network(
    form: str, function: Callable[[Iterator[Value]], Value], *operands: object, same: bool | None = None
) -> Fluent:
    plain = map(unwrap, operands)
    expressions = tuple(each.expression if isinstance(each, Fluent) else Constant(each) for each in plain)
    return Derived(Operation(form, function, expressions), same=same)


def _comparison(
    sign: str, test: Callable[[Value, Value], object], left: object, right: object, *, same: bool | None = None
) -> Fluent:
    return _network(f"{{}} {sign} {{}}", lambda values: True if test(*values) else None, left, right, same=same)


export("pycram.fluent", FalseEndsWait, NotSettable, NotTrueOrFalse)


class StateStream:
    """All states of an expression from the beginning of the ``with`` block to its end."""

    def __init__(self, expression: Expression) -> None:
        self._expression = expression
        self._news = Condition()
        self._states: deque[State] = deque()

    def __enter__(self) -> Self:
        with lock:
            for leaf in self._expression.leaves:
                leaf.waiters.append(self)
            self.state_changed()
        return self

    def __exit__(self, *_: object) -> None:
        with lock:
            for leaf in self._expression.leaves:
                leaf.waiters.remove(self)

    def state_changed(self) -> None:
        """Append the present state; the caller holds the lock."""
        self._states.append({leaf: leaf.held for leaf in self._expression.leaves})
        self._news.notify_all()  # also if older states remain, because the waiting branch takes states without the lock

    def states(self, limit: Deadline | None = None) -> Iterator[State]:
        """Yield the states in order until the deadline, even if new states still come."""
        clock = next(filter(None, (variable.clock() for variable in self._expression.variables())), None)
        while True:
            late = limit is not None and limit.has_come
            if self._states:
                checkpoint()  # once for all states, because a reaction must keep up with 30 states a second
            for _ in range(len(self._states)):
                raise_if_cancelled()
                yield self._states.popleft()
            if late:
                return
            wait_until(self._news, lambda: bool(self._states), limit, clock=clock, reason=self._reason)

    def _reason(self) -> tuple[str, str, list[str]]:
        text = self._expression.text()
        text = text if len(text) <= _MAX_NAME else f"{text[: _MAX_NAME - 3]}..."
        variables = dict.fromkeys(self._expression.variables())
        if any(each.source for each in variables):
            return f"{text}, while nobody simulates", "", []
        set_by = [each.set_by for each in variables if each.set_by]
        return text if set_by else f"{text}, which nobody has set", "last set by", set_by


def first_value(expression: Expression, timeout: float | None = None) -> Value:
    """Wait until an expression has a value that is not None, and return the value; None after the timeout in s."""
    with StateStream(expression) as stream, nullcontext() if timeout is None else Deadline(timeout) as limit:
        values = (expression.value(state) for state in stream.states(limit))
        return next((value for value in values if value is not None), None)


@overload
def whenever(fluent: Fluent) -> Iterator[Value]: ...


@overload
def whenever(fluent: Fluent, body: Callable[[], object]) -> None: ...


@lazy("`s(whenever, fluent, body)`: without a body, `whenever` returns an iterator for a `for` loop")
def whenever(fluent: Fluent, body: Callable[[], object] | None = None) -> Iterator[Value] | None:
    """Run a body whenever a fluent's value is not None; the body is repeated until the value is None.

    To run the body once for each change, use a counter: :meth:`Fluent.rising`, :meth:`Fluent.falling`,
    :meth:`Fluent.changed` or :meth:`Fluent.pulsed`. The behavior of a counter decides whether one run of the body
    handles several changes::

        for _ in whenever(door.pulsed()):
            look_at(door)

        with pursue as s:
            s(whenever, (battery < 20).rising(), charge)
            s(plan)

    The repetition ends when the body raises an error or breaks the loop, or when the branch is cancelled.

    Returns:
        Without a body, an iterator that waits, and yields each value that isn't None.

    Raises:
        BadArgument: ``fluent`` isn't a fluent, or the body isn't callable.
        Cancelled: The branch is cancelled.
    """
    watched = unwrap(fluent)
    if not isinstance(watched, Fluent):
        raise BadArgument("fluent", watched, "a fluent")
    runs = _runs(watched.expression)
    if body is None:
        return runs
    if not callable(body):
        raise BadArgument("body", body, "a function without arguments")
    for _ in runs:
        with span("whenever", watched.name):
            run(body)
    return None


def _runs(expression: Expression) -> Iterator[Value]:
    await_turn()
    counters = [leaf for leaf in expression.leaves if isinstance(leaf, PulseCounter)]
    while True:
        checkpoint()
        value = first_value(expression)
        for counter in counters:
            counter.take()
        try:
            yield value
        finally:
            for counter in counters:
                counter.settle()
