"""Failures defined by users propagate through all of the plan language as PyCRAM's own do."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from pycram.failures import BranchesFailed, PlanFailure, UsageError
from pycram.language import failure_handling, finally_, par, seq, timeout

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@dataclass(eq=False)
class Spill(PlanFailure):
    """A failure with a field that has a name of a block's failure."""

    litres: float
    block: str = "kitchen"


@dataclass(eq=False)
class BigSpill(Spill):
    """One of the same family."""

    people: int = 3


class Jam(PlanFailure):
    """A failure that works out something by a name of a block's failure."""

    @property
    def failures(self) -> str:
        return "two drawers"


@dataclass(eq=False)
class Misuse(UsageError):
    """A usage error."""

    line: int


def spill() -> None:
    raise BigSpill(0.5)


def jam() -> None:
    raise Jam


def misuse() -> None:
    raise Misuse(7)


@contextmanager
def held() -> Iterator[None]:
    yield


def in_time(action: Callable[[], None]) -> None:
    with timeout(60):
        action()


def with_cleanup(action: Callable[[], None]) -> None:
    with finally_(print):
        action()


def in_managers(action: Callable[[], None]) -> None:
    with held(), held():
        action()


WAYS = [in_time, with_cleanup, in_managers, seq, par, failure_handling(2).run]


@pytest.mark.parametrize("way", WAYS)
def test_a_failure_propagates_unchanged(way: Callable[[Callable[[], None]], None]) -> None:
    with pytest.raises(Spill) as raised:
        way(spill)
    assert raised.value.litres == 0.5
    assert raised.value.data["people"] == 3


@pytest.mark.parametrize("way", WAYS)
def test_a_usage_error_propagates_unchanged(way: Callable[[Callable[[], None]], None]) -> None:
    with pytest.raises(Misuse):
        way(misuse)


def test_failures_of_earlier_attempts_are_its_context() -> None:
    with pytest.raises(Spill) as raised:
        failure_handling(2).run(spill)
    earlier = raised.value.__context__
    assert isinstance(earlier, Spill)
    assert isinstance(earlier.__context__, Spill)


def test_a_block_of_failures_is_of_their_type() -> None:
    with pytest.raises(BranchesFailed) as raised:
        par(spill, spill)
    failed = raised.value
    assert isinstance(failed, Spill)
    assert failed.block == "par"
    assert [type(one) for one in failed.failures] == [BigSpill, BigSpill]


def test_a_block_of_failures_with_a_conflicting_property_has_them_all() -> None:
    with pytest.raises(Jam) as raised:
        par(jam, jam)
    failed = raised.value
    assert isinstance(failed, BranchesFailed)
    assert [type(one) for one in failed.failures] == [Jam, Jam]
    assert str(failed) == "par failed: Jam; Jam"
