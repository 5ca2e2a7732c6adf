"""Actions act when they are called; coroutine and generator functions are refused."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import pytest

from pycram.failures import BadArgument
from pycram.fluent import Fluent, whenever
from pycram.language import failure_handling, finally_, par, pursue, seq

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator


def as_branch(action: Callable[[], object]) -> None:
    with par as s:
        s(lambda: s(action))


def as_cleanup(action: Callable[[], object]) -> None:
    with finally_(action):
        pass


def as_reaction(action: Callable[[], object]) -> None:
    whenever(Fluent(value=1), action)


RUNNERS: list[Callable[[Callable[[], object]], object]] = [
    as_branch,
    as_cleanup,
    as_reaction,
    pursue,
    seq,
    failure_handling(1).run,
]


class Counting:
    """A method and an object that return generators when called."""

    def count(self) -> Iterator[int]:
        yield 1

    def __call__(self) -> Iterator[int]:
        """Counts."""
        yield 1


def counting() -> Iterator[int]:
    yield 1


@functools.wraps(counting)
def decorated() -> Iterator[int]:
    return counting()


@pytest.mark.parametrize("run", RUNNERS)
def test_async_functions_are_refused(run: Callable[[Callable[[], object]], object]) -> None:
    async def fetch() -> int:
        return 1

    async def fetch_more() -> AsyncIterator[int]:
        yield 1

    for action in (fetch, fetch_more):
        with pytest.raises(BadArgument, match=r"fetch.*a plain function"):
            run(action)


@pytest.mark.parametrize("run", RUNNERS)
def test_generator_functions_are_refused(run: Callable[[Callable[[], object]], object]) -> None:
    with pytest.raises(BadArgument, match=r"counting.*runs only when its values are read"):
        run(counting)


@pytest.mark.parametrize("action", [Counting().count, Counting(), functools.partial(counting), decorated])
def test_generator_functions_are_refused_however_wrapped(action: Callable[[], object]) -> None:
    with pytest.raises(BadArgument, match="runs only when its values are read"):
        par(action)


@pytest.mark.parametrize("action", [whenever, functools.partial(whenever)])
def test_whenever_as_a_branch_needs_a_body(action: Callable[[Fluent], object]) -> None:
    with pytest.raises(BadArgument, match=r"`s\(whenever, fluent, body\)`"), par as s:
        s(action, Fluent(value=1))


def test_a_plain_function_may_return_a_generator() -> None:
    def expression() -> Iterator[int]:
        return (number for number in (1, 2))

    def begun() -> Iterator[int]:
        numbers = counting()
        next(numbers)
        return numbers

    with par as s:
        first, second, third = s(expression), s(begun), s(lambda: [*counting()])
    assert [*first] == [1, 2]
    assert [*second] == []
    assert third == [1]
