"""The function ``whenever`` runs a body each time that a fluent has a value, until the surrounding block is decided."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import overload

from pycram.fluents.expressions import Expression, PulseCounter, Value
from pycram.fluents.fluent import Fluent, first_value
from pycram.foundation.failures import BadArgument
from pycram.language.branch import lazy, run
from pycram.language.nesting import await_turn
from pycram.scheduling.cancellation import checkpoint
from pycram.scheduling.future import unwrap
from recorder.tracing.span import span


@overload
def whenever(fluent: Fluent) -> Iterator[Value]: ...


@overload
def whenever(fluent: Fluent, body: Callable[[], object]) -> None: ...


@lazy("`s(whenever, fluent, body)`: without a body, `whenever` returns an iterator for a `for` loop")
def whenever(fluent: Fluent, body: Callable[[], object] | None = None) -> Iterator[Value] | None:
    """Run a body whenever a fluent's value is not None; the body repeats while the value stays like that.

    To run the body once for each change, use a counter: :meth:`Fluent.rising`, :meth:`Fluent.falling`,
    :meth:`Fluent.changed` or :meth:`Fluent.pulsed`. The behavior of a counter decides whether one run of the body
    handles several changes::

        for _ in whenever(door.pulsed()):
            look_at(door)

        with pursue as s:
            s(whenever, (battery < 20).rising(), charge)
            s(plan)

    Both forms run in the thread that calls them. The repetition ends when the surrounding block is decided and so
    cancels the branch, and when the body raises an error. A ``break`` also ends the loop.

    Returns:
        Without a body, the result is an iterator that waits, and yields each value that isn't None.

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
