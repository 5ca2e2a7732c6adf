"""Solutions of a designator: found when they are requested, and kept."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

#: All parameters of an action, by name.
Solution: TypeAlias = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Resolution:
    """How a solution was found.

    Attributes:
        resolver: qualified name of the function that gave it; "" if none did.
        index: which of the designator's solutions it is, from 0.
        known: how many were found by now; further ones are found when they are requested.
        complete: whether there are no others.
    """

    resolver: str = ""
    index: int = 0
    known: int = 1
    complete: bool = False


class Solutions:
    """The solutions that a designator and its next ones share, in any number of threads.

    Resolvers run without a lock: they may wait for a thread that requests the same solutions. Concurrent threads each
    search, and the first to find a solution decides.

    Args:
        find: Yields the solutions, each with the name of what gave it; called again after it failed, and then the known
            ones are skipped.
    """

    def __init__(self, find: Callable[[], Iterator[tuple[Solution, str]]]) -> None:
        self._lock = threading.Lock()
        self._find = find
        self._rest: Iterator[tuple[Solution, str]] | None = None  # yields those after the kept ones
        self._kept: list[tuple[Solution, str]] = []
        self._complete = False

    def at(self, index: int) -> Solution | None:
        """Return the solution of an index from 0; None if there are fewer."""
        while True:
            with self._lock:
                count = len(self._kept)
                if index < count or self._complete:
                    return self._kept[index][0] if index < count else None
                rest, self._rest = self._rest, None
            if rest is None:
                rest = itertools.islice(self._find(), count, None)
            solution = next(rest, None)
            with self._lock:
                if len(self._kept) == count:  # no other thread was faster
                    self._rest = rest
                    self._complete = solution is None
                    if solution is not None:
                        self._kept.append(solution)

    def resolution(self, index: int) -> Resolution:
        """Return how the solution of an index was found, as far as it was."""
        with self._lock:
            resolver = self._kept[index][1] if index < len(self._kept) else ""
            return Resolution(resolver, index, len(self._kept), self._complete)
