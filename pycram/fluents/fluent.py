"""Fluents: values that the threads of a plan share, wait for and react to (thesis 3.5.3).

A fluent has a value; any thread may read it, set it, and wait until it is not None::

    battery = Fluent(100, "battery")
    low = (battery < 20).OR(battery.IS(None))

    with pursue as s:
        s(plan)
        s(low.wait_for)

Operators make networks, whose value follows from that of their operands at one moment. Comparisons and AND, OR, NOT,
IS, IS_NOT give True or None, never False: one waits for what is not None. None means that there is no value (yet), so
it is neither less nor more than anything, and no sum has a value if a part has none. AND and OR look at their second
operand only if they have to, as in ``(speed != 0).AND(way / speed < 10)``.

Setting a fluent pulses it, also with the value that it has. What pulses a fluent pulses the networks made of it.
:meth:`Fluent.pulsed` counts pulses, and :func:`whenever` handles them.

Waiting never misses a value, however short it is there, and ends at once when the branch is cancelled. Functions of
networks run in the thread that asks or waits, without any lock held; they may do what they like, but should be quick
and depend on their arguments only. :mod:`pycram.fluents.world` has fluents that follow a world.
"""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING

from pycram.fluents.expressions import Constant, Ended, Operation, Value
from pycram.fluents.pulses import Account, Behavior
from pycram.fluents.variables import Variable, change, touch
from pycram.fluents.waiting import first_value
from pycram.fluents.whenever import whenever
from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, UsageError
from pycram.language.body import await_turn
from pycram.scheduling.future import unwrap
from pycram.world.event import qualified_name
from recorder.tracing.span import span

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pycram.fluents.expressions import Term

__all__ = ["Behavior", "Fluent", "NotSettable", "NotTrueOrFalse", "network", "whenever"]


class NotSettable(UsageError):
    """A value was given to a fluent whose value comes from elsewhere.

    Attributes:
        fluent: name of the fluent.
        of_world: whether that is a world; else it comes from other fluents.
    """

    def __init__(self, fluent: str, of_world: bool) -> None:
        told = "is what the world says; change the world" if of_world else "follows from other fluents; set these"
        super().__init__(f"{fluent} can't be set: its value {told}")
        self.fluent = fluent
        self.of_world = of_world


class NotTrueOrFalse(UsageError):
    """A fluent itself was used as a condition, instead of its value.

    Attributes:
        fluent: name of the fluent.
    """

    def __init__(self, fluent: str) -> None:
        super().__init__(
            f"{fluent} is a fluent, neither true nor false; ask its get_value(), and combine fluents with AND, OR, NOT"
        )
        self.fluent = fluent


class Fluent:
    """A value that threads share.

    Fluents are hashable and equal to themselves only, though ``==`` makes a network: they can stand in sets,
    dictionaries and lists of fluents, and ``in`` finds them there. In a list that holds other things too, ``in`` asks
    whether those are ``==``, and that is neither true nor false: it raises NotTrueOrFalse, as ``if fluent == 3`` does;
    ``any(one is fluent for one in things)`` finds it there. A network that is dropped leaves nothing behind in its
    operands.

    Args:
        value: what it is at the beginning; a handle's result.
        name: what recordings call it; "fluent_1", "fluent_2", ... by default.

    Raises:
        BadArgument: the name isn't text, or the value is a function.
    """

    __slots__ = ("__weakref__", "term")
    __array_ufunc__ = None  # NumPy's arrays leave operators to us

    term: Term
    """Where its value comes from."""

    def __init__(self, value: Value = None, name: str | None = None) -> None:
        self.term = Variable(_checked(value), None if name is None else checks.text("name", name))

    @property
    def name(self) -> str:
        """What it is called; of a network the operation that it is."""
        return self.term.text()

    def __repr__(self) -> str:
        return f"Fluent({self.name})"

    def __record__(self) -> object:
        """How it stands in records."""
        return {"fluent": self.name}

    # --- value -----------------------------------------------------------------------------------------------------

    def get_value(self) -> Value:
        """Its value now.

        Raises:
            WorldClosed: something that it follows is gone.
            Exception: what a function of the network raised.
        """
        return self.term.value(self.term.state())

    def set_value(self, value: Value) -> None:
        """Gives it a value, pulses it and wakes all that wait for it, or for networks made of it.

        Args:
            value: the new value; a handle's result.

        Raises:
            NotSettable: it is a network, counts pulses or follows a world.
            BadArgument: the value is a function.
            RecordingError: the change can't be recorded; it isn't made then.
        """
        change({self._variable: _checked(value)})

    @property
    def _variable(self) -> Variable:
        if isinstance(self.term, Variable) and not self.term.source:
            return self.term
        raise NotSettable(self.name, isinstance(self.term, Variable))

    def wait_for(self, timeout: float | None = None) -> bool:
        """Waits until its value is not None; of one made by :meth:`pulsed`, until there is a pulse to handle.

        Args:
            timeout: in seconds; None to wait for ever.

        Returns:
            True when it is not None, or was for a moment; False when the time is up.

        Raises:
            BadArgument: the timeout isn't a number.
            Cancelled: the branch has been told to stop.
            WorldClosed: something that it follows is gone.
            Exception: what a function of the network raised.
        """
        limit = None if timeout is None else checks.number("timeout", timeout)
        await_turn()
        state = self.term.state()
        found_there = {leaf.text(): held for leaf, held in state.items() if not isinstance(held, Ended)}
        with span("wait", self.name, found_there | ({} if limit is None else {"timeout": limit})) as task:
            task.result = found = first_value(self.term, limit) is not None
            return found

    # --- pulses ----------------------------------------------------------------------------------------------------

    def pulse(self) -> None:
        """Pulses it without changing its value.

        Raises:
            RecordingError: it can't be recorded; it isn't pulsed then.
        """
        touch(self.term)

    def pulsed(self, handle_missed: Behavior = Behavior.ONCE) -> Fluent:
        """A fluent that counts the pulses of this one from now on: True while there are any to handle, else None.

        Each :func:`whenever` takes one of its own; two on the same would share the pulses.

        Args:
            handle_missed: what becomes of pulses that come while an earlier one is handled.

        Raises:
            BadArgument: it isn't a behavior.
        """
        if not isinstance(handle_missed, Behavior):
            raise BadArgument("handle_missed", handle_missed, "Behavior.NEVER, ONCE or ALWAYS")
        return Derived(Account(self.term, handle_missed))

    # --- networks --------------------------------------------------------------------------------------------------

    def AND(self, other: object) -> Fluent:  # noqa: N802  the original's name
        """True if both values are true, else None; the second is looked at only if the first is."""
        return _network("{} AND {}", lambda values: True if all(values) else None, self, other)

    def OR(self, other: object) -> Fluent:  # noqa: N802  the original's name
        """True if one of the values is true, else None; the second is looked at only if the first isn't."""
        return _network("{} OR {}", lambda values: True if any(values) else None, self, other)

    def NOT(self) -> Fluent:  # noqa: N802  the original's name
        """True if the value is false (None, False, 0, empty), else None."""
        return _network("NOT {}", lambda values: None if any(values) else True, self)

    def IS(self, other: object) -> Fluent:  # noqa: N802  the original's name
        """True if the value is the very object that the other is, else None."""
        return _comparison("IS", operator.is_, self, other)

    def IS_NOT(self, other: object) -> Fluent:  # noqa: N802  the original's name
        """True if the value is another object than the other, else None."""
        return _comparison("IS_NOT", operator.is_not, self, other)

    def __eq__(self, other: object) -> Fluent:  # type: ignore[override]  # a network, not an answer
        return _comparison("==", operator.eq, self, other, same=self.is_same(other))

    def __ne__(self, other: object) -> Fluent:  # type: ignore[override]  # as above
        same = self.is_same(other)
        return _comparison("!=", operator.ne, self, other, same=None if same is None else not same)

    def __hash__(self) -> int:
        return hash(self.term)

    def is_same(self, other: object) -> bool | None:
        """Whether another fluent is this one, whatever their values; None for anything that is no fluent."""
        return self.term is other.term if isinstance(other, Fluent) else None

    def __bool__(self) -> bool:
        raise NotTrueOrFalse(self.name)

    def __lt__(self, other: object) -> Fluent:
        return _order("<", operator.lt, self, other)

    def __le__(self, other: object) -> Fluent:
        return _order("<=", operator.le, self, other)

    def __gt__(self, other: object) -> Fluent:
        return _order(">", operator.gt, self, other)

    def __ge__(self, other: object) -> Fluent:
        return _order(">=", operator.ge, self, other)

    def __add__(self, other: object) -> Fluent:
        return _arithmetic("+", operator.add, self, other)

    def __radd__(self, other: object) -> Fluent:
        return _arithmetic("+", operator.add, other, self)

    def __sub__(self, other: object) -> Fluent:
        return _arithmetic("-", operator.sub, self, other)

    def __rsub__(self, other: object) -> Fluent:
        return _arithmetic("-", operator.sub, other, self)

    def __mul__(self, other: object) -> Fluent:
        return _arithmetic("*", operator.mul, self, other)

    def __rmul__(self, other: object) -> Fluent:
        return _arithmetic("*", operator.mul, other, self)

    def __truediv__(self, other: object) -> Fluent:
        return _arithmetic("/", operator.truediv, self, other)

    def __rtruediv__(self, other: object) -> Fluent:
        return _arithmetic("/", operator.truediv, other, self)

    def __floordiv__(self, other: object) -> Fluent:
        return _arithmetic("//", operator.floordiv, self, other)

    def __rfloordiv__(self, other: object) -> Fluent:
        return _arithmetic("//", operator.floordiv, other, self)

    def __mod__(self, other: object) -> Fluent:
        return _arithmetic("%", operator.mod, self, other)

    def __rmod__(self, other: object) -> Fluent:
        return _arithmetic("%", operator.mod, other, self)

    def __pow__(self, other: object) -> Fluent:
        return _arithmetic("**", operator.pow, self, other)

    def __rpow__(self, other: object) -> Fluent:
        return _arithmetic("**", operator.pow, other, self)

    def __neg__(self) -> Fluent:
        return _arithmetic_of_one("-{}", operator.neg, self)

    def __pos__(self) -> Fluent:
        return _arithmetic_of_one("+{}", operator.pos, self)

    def __abs__(self) -> Fluent:
        return _arithmetic_of_one("abs({})", abs, self)


class Derived(Fluent):
    """A fluent whose value is not set, but comes from other fluents or from a world.

    Args:
        term: where its value comes from.
        same: of ``==`` and ``!=`` between two fluents, what lists and ``in`` want to know: whether they are the same
            one, or not.
    """

    __slots__ = ("_same",)

    def __init__(self, term: Term, *, same: bool | None = None) -> None:
        self.term = term
        self._same = same

    def __bool__(self) -> bool:
        if self._same is None:
            raise NotTrueOrFalse(self.name)
        return self._same


def network(function: Callable[..., Value], *operands: object) -> Fluent:
    """A fluent whose value is what a function makes of the operands' values, all at the same moment.

    Args:
        function: takes one value for each operand; called whenever somebody needs the network's value.
        operands: fluents or plain values.

    Raises:
        BadArgument: it can't be called.
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
    terms = tuple(one.term if isinstance(one, Fluent) else Constant(one) for one in plain)
    return Derived(Operation(form, function, terms), same=same)


def _comparison(
    sign: str, test: Callable[[Value, Value], object], one: object, other: object, *, same: bool | None = None
) -> Fluent:
    return _network(f"{{}} {sign} {{}}", lambda values: True if test(*values) else None, one, other, same=same)


def _order(sign: str, test: Callable[[Value, Value], object], one: object, other: object) -> Fluent:
    return _comparison(sign, lambda a, b: a is not None and b is not None and test(a, b), one, other)


def _arithmetic(sign: str, function: Callable[[Value, Value], Value], one: object, other: object) -> Fluent:
    def work_out(values: Iterator[Value]) -> Value:
        a, b = values
        return None if a is None or b is None else function(a, b)

    return _network(f"{{}} {sign} {{}}", work_out, one, other)


def _arithmetic_of_one(form: str, function: Callable[[Value], Value], one: Fluent) -> Fluent:
    def work_out(values: Iterator[Value]) -> Value:
        (a,) = values
        return None if a is None else function(a)

    return _network(form, work_out, one)
