"""Solutions of a designator: found when they are requested, and kept."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

#: All parameters of an action, by name.
Solution: TypeAlias = Mapping[str, Any]


class Solutions:
    """The solutions that a designator and its next ones share, in any number of threads.

    Resolvers run without a lock: they may wait for a thread that requests the same solutions. Concurrent threads each
    search, and the first to find a solution decides.

    Args:
        find: Yields the solutions; called again after it failed, and then the known ones are skipped.
    """

    def __init__(self, find: Callable[[], Iterator[Solution]]) -> None:
        self._lock = threading.Lock()
        self._find = find
        self._rest: Iterator[Solution] | None = None  # yields those after the kept ones
        self._kept: list[Solution] = []
        self._complete = False

    def at(self, index: int) -> Solution | None:
        """Return the solution of an index from 0; None if there are fewer."""
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
                if len(self._kept) == count:  # no other thread was faster
                    self._rest = rest
                    self._complete = solution is None
                    if solution is not None:
                        self._kept.append(solution)
