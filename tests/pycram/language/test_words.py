"""The five words of the language: with and without parentheses, as functions, again and again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pycram.failures import BadArgument
from pycram.language import par, try_in_order
from pycram.language.failures import BlockClosed
from tests.pycram.language.gates import KINDS, Meeting, fails, succeeds

if TYPE_CHECKING:
    from collections.abc import Callable


def test_functions_in_a_body_are_branches() -> None:
    meeting = Meeting(2)
    with par:
        results = par(meeting.wait, lambda: 3)
        nested = try_in_order(fails, meeting.wait)
    assert results[1] == 3
    assert {results[0], nested.result()} == {0, 1}


def test_a_branch_may_add_others_until_the_block_has_ended() -> None:
    done = []
    with par as s:
        s(lambda: s(lambda: s(done.append, 1)))
    assert done == [1]
    assert len(s.branches) == 3
    with pytest.raises(BlockClosed):
        s(succeeds)
    with pytest.raises(BadArgument):
        par(1)
    with pytest.raises(BadArgument), par as s:
        s("not a function")


@pytest.mark.parametrize("name", KINDS)
def test_no_functions_give_no_results(name: str) -> None:
    functions: list[Callable[[], object]] = []
    results = KINDS[name](*functions)
    assert results == []
    assert [*results] == []


def test_the_five_words_are_reusable_in_threads_and_within_themselves() -> None:
    def deep(levels: int) -> int:
        if not levels:
            return 1
        with par as s:
            parts = [s(deep, levels - 1) for _ in range(2)]
        return sum(part.result() for part in parts)

    assert deep(4) == 16
    opening = par()
    with opening as s, opening as t:
        assert s is not t
    assert repr(par) == "par"
