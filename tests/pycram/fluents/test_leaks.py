"""Dropped networks are freed."""

from __future__ import annotations

import gc

import pytest

from pycram.fluent import Fluent
from pycram.fluents.expressions import Expression
from pycram.fluents.fluent import StateStream


@pytest.mark.slow
def test_dropped_networks_are_freed() -> None:
    def alive() -> int:
        # isinstance() would ask futures of other tests for their results
        return sum(issubclass(type(thing), (Fluent, Expression, StateStream)) for thing in gc.get_objects())

    fluent = Fluent(1)
    gc.collect()  # what tests before this one left
    before = alive()
    for number in range(500):
        of_it = (fluent > number).AND(fluent + 1).pulsed()
        assert not of_it.wait_for(0)
        fluent.pulse()
    del of_it
    assert alive() == before, "gone at once, without the garbage collector"
    assert not fluent.expression.waiters
    assert not fluent.expression.counters


def test_a_network_keeps_its_operands_alive() -> None:
    total = Fluent(1) + Fluent(2)
    pulsed = (Fluent(1) + 1).pulsed()
    gc.collect()
    assert total.get_value() == 3
    assert pulsed.get_value() is None
