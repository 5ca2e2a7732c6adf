"""Pulses, and how whenever handles them."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np
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


def handled(pulsed: Fluent) -> int:
    """Return how many pulses there are to handle."""
    count = 0
    for _ in whenever(pulsed):
        count += 1
        if pulsed.get_value() is None:
            break
    return count


@pytest.mark.parametrize(
    ("count", "expected"),
    [(Fluent.rising, 2), (Fluent.falling, 1), (Fluent.changed, 3), (Fluent.pulsed, 3)],
)
def test_each_crossing_of_a_limit_counts_once(count: Callable[[Fluent, Behavior], Fluent], expected: int) -> None:
    height = Fluent(1.0, "height")
    counted = count(height < 0.5, Behavior.ALWAYS)
    for value in (0.9, 0.4, 0.3, 0.2, 0.2, 0.8, 1.0, 0.1):
        height.set_value(value)
    assert handled(counted) == expected


def test_a_fluent_with_a_value_of_its_own_pulses_whenever_it_is_set_and_changes_only_to_other_values() -> None:
    door = Fluent("shut", "door")
    pulsed, changed = door.pulsed(Behavior.ALWAYS), door.changed(Behavior.ALWAYS)
    for state in ("shut", "open", "open"):
        door.set_value(state)
    door.pulse()
    assert (handled(pulsed), handled(changed)) == (4, 1)
    assert [fluent.name for fluent in (pulsed, changed)] == ["door.pulsed(ALWAYS)", "door.changed(ALWAYS)"]


def test_a_change_back_while_nobody_waits_is_two_crossings() -> None:
    level = Fluent(10)
    low, high = (level < 5).rising(), (level < 5).falling()
    level.set_value(3)
    level.set_value(10)
    assert (low.get_value(), high.get_value()) == (True, True)
    assert (handled(low), handled(high)) == (1, 1)


def test_an_error_of_a_network_is_raised_once_and_later_changes_count() -> None:
    ahead = Fluent(2.0)
    near = (1 / ahead > 1).rising()
    ahead.set_value(0.0)
    with pytest.raises(ZeroDivisionError):
        near.wait_for(0)
    assert near.get_value() is None
    ahead.set_value(0.5)
    assert handled(near) == 1


def test_changes_of_arrays_count() -> None:
    place = Fluent(np.zeros(3))
    changed = place.changed()
    place.set_value(np.ones(3))
    assert changed.get_value() is True
