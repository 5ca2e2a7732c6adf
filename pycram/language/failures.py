"""Failures that are made of others: that of a block, and that of a cleaning up.

A failed block raises one failure that carries those of all its branches, and is of the types that all of them have in
common.
"""

from __future__ import annotations

import functools
import traceback
from typing import TYPE_CHECKING

from pycram.foundation.error_families import PlanFailure, PycramError, slots_of
from pycram.foundation.names import export
from recorder.records import format_error

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence


class BranchesFailed(PlanFailure):
    """A block of the plan language failed: one failure that carries those of all its branches.

    It can be caught as what they are: where all of them are ``Unreachable``, ``except Unreachable`` catches it, and it
    has the fields of the first of them; where they differ, as what they have in common, ``PlanFailure`` at last. So who
    catches it by a type has handled all that went wrong, and no failure of another type vanishes beside it.
    """

    def __new__(cls, block: str, failures: Iterable[PlanFailure]) -> BranchesFailed:  # noqa: PYI034  a subclass
        """Makes an instance that is also of the types that all failures have in common."""
        failures = tuple(failures)
        if cls is BranchesFailed:
            kind = _together(tuple(type(leaf) for leaf in _leaves(failures)))
            return super().__new__(kind, block, failures)
        return super().__new__(cls, block, failures)

    def __init__(self, block: str, failures: Iterable[PlanFailure]) -> None:
        members = tuple(failures)
        fields = vars(self)  # not by assignments: it may be of a type that refuses them
        if len(type(self).__bases__) > 1:
            first = next(_leaves(members))
            fields.update(vars(first))
            for slot in slots_of(first):
                if isinstance(self, slot.__objclass__):
                    slot.__set__(self, slot.__get__(first))
        fields.update(block=block, failures=members)
        self.__cause__ = members[0] if len(members) == 1 else Tracebacks(members)

    @property
    def block(self) -> str:
        """What the block is: "par", ... A property, since the type of its failures may have another one."""
        return str(vars(self)["block"])

    @property
    def failures(self) -> tuple[PlanFailure, ...]:
        """What its branches and its body raised, in order."""
        failures: tuple[PlanFailure, ...] = vars(self)["failures"]
        return failures

    @property
    def leaves(self) -> tuple[PlanFailure, ...]:
        """What went wrong in the end: its failures, and in place of failed blocks among them theirs."""
        return tuple(_leaves(self.failures))

    @property
    def data(self) -> Mapping[str, object]:
        """Its fields by name; of its failures type, message and fields."""
        told = [{"type": type(one).__name__, "message": str(one), "data": one.data} for one in self.failures]
        return {**super().data, "failures": told}

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle what it is made of, as its class has been made for its failures."""
        return BranchesFailed, (self.block, self.failures)

    def __str__(self) -> str:
        told = (
            str(failure) if isinstance(failure, BranchesFailed) else format_error(failure) for failure in self.failures
        )
        return f"{self.block} failed: {'; '.join(told)}"


class NotCleanedUp(PlanFailure):
    """Something was told to stop, by its block or a timeout, and what it does at its end (``finally_``) failed.

    Attributes:
        action: what it does at its end.
        failure: what that failed with; the cause of this.
    """

    def __init__(self, action: str, failure: PlanFailure) -> None:
        super().__init__(f"{action}, done as the plan was told to stop, failed: {format_error(failure)}")
        self.action = action
        self.failure = failure
        self.__cause__ = failure


def leaves_uncleaned(failure: BaseException) -> bool:
    """Whether a failure is, or holds, that of a cleaning up which nobody reckons with."""
    leaves = failure.leaves if isinstance(failure, BranchesFailed) else (failure,)
    return any(isinstance(leaf, NotCleanedUp) for leaf in leaves)


class Tracebacks(PycramError):
    """Never raised: the cause of a :class:`BranchesFailed` with several failures, so that tracebacks print them all.

    Attributes:
        failures: the failures.
    """

    def __init__(self, failures: Sequence[BaseException]) -> None:
        super().__init__(failures)
        self.failures = tuple(failures)

    def __str__(self) -> str:
        lines = []
        for number, failure in enumerate(self.failures, 1):
            lines.append(f"{number} of {len(self.failures)}")
            lines += ["  | " + line for line in "".join(traceback.format_exception(failure)).splitlines()]
        return "\n".join(lines)


def _leaves(failures: Iterable[PlanFailure]) -> Iterator[PlanFailure]:
    for failure in failures:
        if isinstance(failure, BranchesFailed):
            yield from _leaves(failure.failures)
        else:
            yield failure


@functools.lru_cache(maxsize=256)
def _together(kinds: tuple[type[PlanFailure], ...]) -> type[BranchesFailed]:
    """BranchesFailed, combined with what all of some types have in common beyond PlanFailure."""
    common: list[type] = []
    for kind in kinds[0].__mro__ if kinds else ():
        shared = issubclass(kind, PlanFailure) and kind is not PlanFailure and all(issubclass(k, kind) for k in kinds)
        if shared and not any(issubclass(known, kind) for known in common):
            common.append(kind)
    if not common:
        return BranchesFailed
    try:
        made = type("BranchesFailed", (BranchesFailed, *common), {"__module__": BranchesFailed.__module__})
        BaseException.__new__(made)
    except TypeError:  # types that can't be combined
        return BranchesFailed
    return made


export("pycram.failures", BranchesFailed, NotCleanedUp)
