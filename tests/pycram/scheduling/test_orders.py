"""Orders that are asked for: ranks, exceptions from them, and random priorities with their bound."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pycram.failures import BadArgument, DeadlockedBranches
from pycram.fluent import Fluent
from pycram.language import par
from pycram.scheduling.cancellation import checkpoint
from pycram.scheduling.order import MOST_IN_A_ROW, Pct, Precedence, Ranked, order_of, text_of
from pycram.scheduling.schedule import scheduler, seed_order

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(autouse=True)
def _unseeded() -> Iterator[None]:
    yield
    seed_order(None)


def turns(order: str, seed: int = 1) -> str:
    """The order in which four branches take three turns each; c's are those of two branches of its own."""
    taken: list[str] = []

    def take(name: str) -> None:
        for _ in range(3):
            checkpoint()
            taken.append(name)

    def divide(name: str) -> None:
        par(lambda: take(name), lambda: take(name.upper()))

    seed_order(seed, order)
    with par as s:
        for name in "abd":
            s(take, name)
        s(divide, "c")
    return "".join(taken)


def test_branches_run_in_rank_until_a_precedence_says_otherwise() -> None:
    assert turns("added") == "aaabbbdddcccCCC"
    assert turns("added:2-1@2") == "abbbaadddcccCCC"
    assert turns("added:3-1@0,1-3@1") == "aaadddbbbcccCCC"
    assert turns("added:4.2-4.1@0") == "aaabbbdddCCCccc"
    assert turns("added:9-1@2") == turns("added")  # there is none


def test_what_was_drawn_is_told_as_precedences_that_make_the_same_order() -> None:
    drawn = set()
    for number in range(60):
        order = turns(f"pct:{number}:4:20")
        made = [each.precedence for each in scheduler().order.applied]
        drawn.add(order)
        assert turns(text_of(made)) == order
        assert [each.precedence for each in scheduler().order.applied] == made
    assert len(drawn) > 40
    assert turns("pct:3:4:20", seed=1) == turns("pct:3:4:20", seed=1) != turns("pct:3:4:20", seed=2)


def test_an_order_begins_anew_whatever_was_waited_for_before() -> None:
    orders = [turns(f"pct:{number}:4:20") for number in range(20)]
    for number, order in enumerate(orders):
        seed_order(None)
        with par as s:
            s(checkpoint)
            s(checkpoint)
        assert turns(f"pct:{number}:4:20") == order


def test_a_race_is_found_as_often_as_the_bound_says() -> None:
    """Two branches of ten steps: that the second runs as a whole between two certain steps of the first is of depth 2."""
    steps, draws = 20, 1500
    found = [0] * 10
    for number in range(draws):
        pct, one, two = Pct(1, number, 2, steps), Ranked("1"), Ranked("2")
        left = {one: 10, two: 10}
        order = []
        while any(left.values()):
            ready = [each for each in left if left[each]]
            chosen = pct.choose(ready)
            order.append(chosen)
            left[chosen] -= 1
        first = order.index(two)
        if first < 10 and order[first : first + 10] == [two] * 10:
            found[first] += 1
    bound = draws / (2 * steps)
    assert min(found) > 0.6 * bound  # three standard deviations
    assert sum(found) > 10 * bound


def test_a_branch_that_polls_lets_the_others_run() -> None:
    done: list[int] = []

    def poll() -> None:
        while not done:
            checkpoint()

    for order in ("added", "pct:1:1:10", "pct:2:1:10"):
        done.clear()
        seed_order(1, order)
        par(poll, lambda: (checkpoint(), done.append(1)))
        assert scheduler().order.turns <= MOST_IN_A_ROW + 3


def test_a_deadlock_is_told_with_where_each_waits() -> None:
    left, right = Fluent(0), Fluent(0)

    def one() -> None:
        (left > 0).wait_for()

    def two() -> None:
        (right > 0).wait_for()

    seed_order(1, "added")
    with pytest.raises(DeadlockedBranches) as raised:
        par(one, two)
    assert list(raised.value.waiting) == ["par-1 one", "par-2 two"]
    assert all(place.startswith("test_orders.py:") for place in raised.value.waiting.values())


def test_a_text_that_is_no_order_is_refused() -> None:
    assert order_of("", 1) is None
    assert str(Precedence("1.2", "3", 4)) == "1.2-3@4"
    for wrong in ("first", "added:", "added:1-2", "added:1-2@3,", "pct:1:0:5", "pct:1:2:0", "pct:1:2"):
        with pytest.raises(BadArgument, match="order"):
            seed_order(1, wrong)
