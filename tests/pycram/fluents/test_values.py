"""Values of networks: operators, and laws that hold for any network."""

from __future__ import annotations

import operator
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, strategies as st

from pycram.fluent import FalseEndsWait, Fluent, network
from pycram.language import par
from tests.pycram.fluents.waiters import waiting

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.mark.parametrize(
    ("network_of", "left", "right", "value"),
    [
        (lambda a, b: a == b, 2, 2, True),
        (lambda a, b: a == b, 2, 3, None),
        (lambda a, b: a != b, 2, 3, True),
        (lambda a, b: a != b, 2, 2, None),
        (lambda a, b: a < b, 2, 3, True),
        (lambda a, b: a < b, 3, 3, None),
        (lambda a, b: a <= b, 3, 3, True),
        (lambda a, b: a <= b, 4, 3, None),
        (lambda a, b: a > b, 3, 2, True),
        (lambda a, b: a > b, 3, 3, None),
        (lambda a, b: a >= b, 3, 3, True),
        (lambda a, b: a >= b, 2, 3, None),
        (lambda a, b: a + b, 2, 3, 5),
        (lambda a, b: a - b, 2, 3, -1),
        (lambda a, b: a * b, 2, 3, 6),
        (lambda a, b: a / b, 3, 2, 1.5),
        (lambda a, b: a + b, "mi", "lk", "milk"),
        (lambda a, b: a.AND(b), True, 1, True),
        (lambda a, b: a.AND(b), True, False, None),
        (lambda a, b: a.AND(b), None, True, None),
        (lambda a, b: a.OR(b), None, "x", True),
        (lambda a, b: a.OR(b), 0, False, None),
        (lambda a, b: a.IS(b), None, None, True),
        (lambda a, b: a.IS(b), [1], [1], None),
        (lambda a, b: a.IS_NOT(b), [1], [1], True),
        (lambda a, b: a.IS_NOT(b), True, True, None),
    ],
)
def test_operators_take_fluents_and_plain_values_on_both_sides(
    network_of: Callable[[object, object], Fluent], left: object, right: object, value: object
) -> None:
    of_two = network_of(Fluent(left), Fluent(right))
    assert (of_two.get_value(), network_of(Fluent(left), right).get_value()) == (value, value)
    assert type(of_two.get_value()) is type(value)
    if not network_of.__code__.co_names:  # an operator, not a method: the fluent may stand on the right
        assert network_of(left, Fluent(right)).get_value() == value


@pytest.mark.parametrize(("value", "negated"), [(None, True), (False, True), (0, True), ("", True), (1, None)])
def test_not_is_true_of_false_values(value: object, negated: object) -> None:
    assert Fluent(value).NOT().get_value() is negated


@pytest.mark.parametrize("value", [True, False, 0, "", (), "milk"])
def test_waiting_ends_with_any_value_but_none(value: object) -> None:
    fluent = Fluent()
    assert not fluent.wait_for(timeout=0)
    with waiting(fluent) as running:
        fluent.set_value(value)
        assert running.end() is True
    with (
        pytest.warns(FalseEndsWait, match=r"wait for \(fluent_\d+ == True\), or make None the first value")
        if value is False
        else nullcontext()
    ):
        assert fluent.wait_for()


def test_a_branch_that_only_waits_is_warned_about_at_the_line_that_added_it() -> None:
    with pytest.warns(FalseEndsWait) as warned, par as s:
        s(Fluent(False).wait_for)
    assert (Path(warned[0].filename).name, warned[0].lineno > 0) == (Path(__file__).name, True)


def test_networks_follow_their_operands() -> None:
    a, b = Fluent(1), Fluent(2)
    total, larger = a + b, (a + b > 4).AND(b.IS_NOT(None))
    assert (total.get_value(), larger.get_value()) == (3, None)
    b.set_value(4)
    assert (total.get_value(), larger.get_value()) == (5, True)
    a.set_value(0.5)
    assert (total.get_value(), larger.get_value()) == (4.5, True)
    scaled = network(lambda x, factor, y: (x * factor, y), a, 10, b)
    assert scaled.get_value() == (5.0, 4)


def test_and_and_or_short_circuit() -> None:
    speed = Fluent(0)
    soon, standing_or_late = (speed != 0).AND(100 / speed < 10), (speed == 0).OR(100 / speed >= 10)
    assert (soon.get_value(), standing_or_late.get_value()) == (None, True)
    speed.set_value(20)
    assert (soon.get_value(), standing_or_late.get_value()) == (True, None)
    speed.set_value(5)
    assert (soon.get_value(), standing_or_late.get_value()) == (None, True)


def test_operators_without_a_value_give_none() -> None:
    reading = Fluent()
    for made in (reading < 20, reading >= 20, reading > Fluent(), reading + 1, 2 * reading, reading / reading - 1):
        assert made.get_value() is None
        with waiting(made) as running:
            assert running.outcome is None
            running.scope.cancel()
    assert (reading == None).get_value() is True  # noqa: E711  a network
    assert reading.IS(None).get_value() is True


def test_errors_of_a_network_are_raised_where_it_is_read_or_awaited() -> None:
    fluent = Fluent(1)
    inverse = 1 / fluent > 2
    with waiting(inverse) as running:
        fluent.set_value(0)
        assert isinstance(running.end(), ZeroDivisionError)
    with pytest.raises(ZeroDivisionError):
        inverse.get_value()
    fluent.set_value(0.1)
    assert inverse.get_value() is True


def test_futures_of_branches_stand_for_their_results() -> None:
    with par as s:
        future = s(lambda: 4)
        fluent = Fluent(future)
        more = fluent + s(lambda: 3)
    assert fluent.get_value() == 4
    assert more.get_value() == 7
    assert type(fluent.get_value()) is int


OPERATORS = {
    "==": (operator.eq, True), "!=": (operator.ne, True), "<": (operator.lt, True), "<=": (operator.le, True),
    ">": (operator.gt, True), ">=": (operator.ge, True), "+": (operator.add, False), "-": (operator.sub, False),
    "*": (operator.mul, False), "AND": (lambda a, b: a and b, True), "OR": (lambda a, b: a or b, True),
}  # fmt: skip


numbers = st.integers(-3, 3)


trees = st.recursive(
    st.sampled_from("abc") | numbers,
    lambda inner: st.tuples(st.sampled_from(sorted(OPERATORS)), inner, inner),
    max_leaves=12,
)


def built(tree: object, fluents: dict[str, Fluent]) -> object:
    if not isinstance(tree, tuple):
        return fluents.get(tree, tree)
    name, left, right = tree[0], built(tree[1], fluents), built(tree[2], fluents)
    if name in ("AND", "OR"):
        return getattr(left if isinstance(left, Fluent) else Fluent(left), name)(right)
    if not isinstance(left, Fluent) and not isinstance(right, Fluent):
        left = Fluent(left)
    return OPERATORS[name][0](left, right)


def expected(tree: object, values: dict[str, int]) -> object:
    if not isinstance(tree, tuple):
        return values.get(tree, tree)
    function, is_condition = OPERATORS[tree[0]]
    operands = [expected(operand, values) for operand in tree[1:]]
    if None in operands and tree[0] not in ("==", "!=", "AND", "OR"):
        return None
    made = function(*operands)
    return (True if made else None) if is_condition else made


@pytest.mark.slow
@given(trees, st.lists(st.tuples(st.sampled_from("abc"), numbers), max_size=5))
def test_a_networks_value_is_the_function_of_its_operands_values(tree: object, sets: list[tuple[str, int]]) -> None:
    values = {"a": 0, "b": 1, "c": 2}
    fluents = {name: Fluent(value, name) for name, value in values.items()}
    made = built(tree, fluents)
    for name, value in [("a", 0), *sets]:
        values[name] = value
        fluents[name].set_value(value)
        assert (made.get_value() if isinstance(made, Fluent) else made) == expected(tree, values)
