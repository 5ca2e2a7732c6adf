"""Pulses, and how whenever handles them."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest

from pycram.failures import Unreachable
from pycram.fluent import Behavior, Fluent, network, whenever
from recorder.tracing.span import Cancelled
from tests.pycram.fluents.waiters import HANG_TIMEOUT, Running

if TYPE_CHECKING:
    from collections.abc import Callable


def runs(pulsed: Fluent, during_the_first: Callable[[], object]) -> int:
    """How often the body of a ``whenever`` runs until it has nothing to do."""
    idle, begun, go_on = threading.Event(), threading.Event(), threading.Event()
    count = 0

    def look(value: object) -> object:
        if value is None and begun.is_set():
            idle.set()
        return value

    def body() -> None:
        nonlocal count
        count += 1
        begun.set()
        assert go_on.wait(HANG_TIMEOUT)

    running = Running(lambda: whenever(network(look, pulsed), body))
    assert begun.wait(HANG_TIMEOUT)
    during_the_first()
    go_on.set()
    assert idle.wait(HANG_TIMEOUT)
    running.scope.cancel()
    assert isinstance(running.end(), Cancelled)
    return count


@pytest.mark.parametrize(("behavior", "expected"), [(Behavior.NEVER, 1), (Behavior.ONCE, 2), (Behavior.ALWAYS, 5)])
@pytest.mark.parametrize("late", [0, 4], ids=["before", "while busy"])
def test_five_pulses_while_the_body_is_busy(behavior: Behavior, expected: int, late: int) -> None:
    fluent = Fluent()
    pulsed = fluent.pulsed(behavior)

    def pulse(times: int) -> None:
        for number in range(times):
            fluent.pulse() if number % 2 else fluent.set_value("the same")

    pulse(5 - late)
    assert runs(pulsed, lambda: pulse(late)) == expected
    assert pulsed.get_value() is None
    fluent.pulse()
    assert pulsed.get_value() is True


def test_once_is_the_default_behavior() -> None:
    fluent = Fluent()
    pulsed = fluent.pulsed()
    for _ in range(5):
        fluent.pulse()
    assert runs(pulsed, lambda: None) == 2


def test_a_pulse_reaches_each_network_of_its_fluent_once_and_no_other() -> None:
    a, b = Fluent(1), Fluent(2)
    both = (a + b) * a
    of_both, of_a, of_b, of_of = both.pulsed(Behavior.ALWAYS), a.pulsed(), b.pulsed(), both.pulsed().pulsed()
    of_pulses = of_both.AND(of_a).pulsed(Behavior.ALWAYS)
    a.pulse()
    assert [fluent.get_value() for fluent in (of_both, of_a, of_b, of_of)] == [True, True, None, True]
    for pulsed in (of_both, of_pulses):
        next(whenever(pulsed))
        assert pulsed.get_value() is None  # one, though two ways lead from a to it
    both.pulse()
    assert [fluent.get_value() for fluent in (of_both, of_b)] == [True, None]


def test_a_loop_handles_each_pulse_until_it_breaks() -> None:
    door = Fluent("shut", "door")
    states = []
    pulsed = door.pulsed(Behavior.ALWAYS)
    for state in ("open", "shut", "open"):
        door.set_value(state)
    for _ in whenever(pulsed):
        states.append(door.get_value())
        if len(states) == 2:
            break
    assert len(states) == 2
    assert pulsed.get_value() is True  # the third


def test_whenever_runs_as_long_as_a_condition_holds() -> None:
    level = Fluent(3)
    poured = 0
    for value in whenever(network(lambda x: x or None, level)):
        assert value == level.get_value()
        poured += 1
        level.set_value(level.get_value() - 1)
        if level.get_value() == 0:
            break
    assert poured == 3


def test_an_error_of_the_body_ends_whenever() -> None:
    fluent = Fluent(1)

    def body() -> None:
        raise Unreachable("left", [1, 2, 3])

    with pytest.raises(Unreachable):
        whenever(fluent, body)
