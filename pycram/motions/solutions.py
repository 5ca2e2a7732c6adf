"""Solutions of a description: found as they are asked for, and kept."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

#: What a reference is: all parameters by name.
Solution: TypeAlias = Mapping[str, Any]


class Solutions:
    """What a designator and its next ones share; any number of threads may ask.

    Finding is the resolvers' code and runs without a lock: a resolver may wait for a thread that asks for the same
    solutions. Threads that look at the same time each look themselves, and the first to find one decides.
    """

    def __init__(self, find: Callable[[], Iterator[Solution]]) -> None:
        """Begins with none.

        Args:
            find: gives the solutions; called again when it failed, and then the first ones are skipped.
        """
        self._lock = threading.Lock()
        self._find = find
        self._rest: Iterator[Solution] | None = None  # gives what comes after those that are kept
        self._kept: list[Solution] = []
        self._complete = False

    def at(self, index: int) -> Solution | None:
        """A solution.

        Args:
            index: its number, from 0.

        Returns:
            The solution, None if there are fewer.
        """
        while True:
            with self._lock:
                count = len(self._kept)
                if index < count or self._complete:
                    return self._kept[index] if index < count else None
                rest, self._rest = self._rest, None
            if rest is None:
                rest = itertools.islice(self._find(), count, None)
            solution = next(rest, None)
            with self._lock:
                if len(self._kept) == count:  # nobody was faster
                    self._rest = rest
                    self._complete = solution is None
                    if solution is not None:
                        self._kept.append(solution)
