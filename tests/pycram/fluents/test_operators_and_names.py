"""Fluents in lists, conditions and arithmetic; which can be set, and their names."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram.failures import BadArgument, Unreachable
from pycram.fluent import Fluent, NotSettable, NotTrueOrFalse, network, whenever

if TYPE_CHECKING:
    from collections.abc import Callable


def test_fluents_can_be_in_sets_lists_and_dictionaries() -> None:
    a, b, c = Fluent(1), Fluent(1), Fluent(1)
    assert {a, b, a} == {b, a}
    assert {a: "a", b: "b"}[b] == "b"
    assert b in [a, b]
    assert c not in [a, b]
    assert c not in {a, b}
    assert [a, b, c].index(c) == 2
    assert (a == b).get_value() is True


@pytest.mark.parametrize(
    "condition", [lambda f: f, lambda f: f == 1, lambda f: f < 2, lambda f: f.NOT(), lambda f: 0 < f < 2]
)
def test_a_fluent_as_a_condition_is_refused_with_advice(condition: Callable[[Fluent], object]) -> None:
    with pytest.raises(NotTrueOrFalse, match=r"get_value\(\).*AND"):
        assert condition(Fluent(1))


def test_a_fluent_in_a_list_of_other_values_is_refused() -> None:
    fluent = Fluent(1)
    things: list[object] = [3, fluent]
    with pytest.raises(NotTrueOrFalse):
        assert fluent in things
    assert any(thing is fluent for thing in things)


def test_arithmetic_operators_and_their_names() -> None:
    a, b, none = Fluent(7, "a"), Fluent(2, "b"), Fluent(None, "c")
    for made, value, name in (
        (a // b, 3, "a // b"),
        (15 // a, 2, "15 // a"),
        (a % 4, 3, "a % 4"),
        (9 % a, 2, "9 % a"),
        (a**b, 49, "a ** b"),
        (2**a, 128, "2 ** a"),
        (-a + b, -5, "(-a) + b"),
        (+a, 7, "+a"),
        (abs(b - a), 5, "abs((b - a))"),
    ):
        assert (made.get_value(), made.name) == (value, name)
    assert [made.get_value() for made in (none // 2, none % 2, none**2, -none, abs(none))] == [None] * 5


def test_operators_with_arrays_make_networks() -> None:
    shift = np.array([1.0, 2.0])
    moved = shift + Fluent(np.array([1.0, 1.0]))
    assert isinstance(moved, Fluent)
    assert moved.get_value().tolist() == [2.0, 3.0]


def test_only_variables_can_be_set() -> None:
    fluent = Fluent(1)
    for derived in (fluent + 1, fluent.pulsed()):
        with pytest.raises(NotSettable, match="other fluents"):
            derived.set_value(2)
    for function in (lambda: 1, test_only_variables_can_be_set):
        with pytest.raises(BadArgument, match="network"):
            Fluent(function)
    assert Fluent(Unreachable).get_value() is Unreachable
    with pytest.raises(BadArgument, match="Behavior"):
        fluent.pulsed(2)
    with pytest.raises(BadArgument):
        whenever(1)
    with pytest.raises(BadArgument):
        whenever(fluent, 1)
    with pytest.raises(BadArgument):
        network(1, fluent)


def test_names_of_networks_spell_out_their_operations() -> None:
    a, b = Fluent(1, "a"), Fluent(2, "b")
    assert repr((a + 1 > b).AND(a.NOT())) == "Fluent(((a + 1) > b) AND (NOT a))"
    assert (network(math.hypot, a, b) > 3).name == "hypot(a, b) > 3"
    assert a.pulsed().name == "a.pulsed(ONCE)"
    assert (a == {"{}": 1}).name == "a == {'{}': 1}"
    deep = a
    for _ in range(300):
        deep = deep + deep
    assert len(deep.name) < 500
    assert deep.get_value() == 2**300
