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

    Finding is the resolvers' code, which runs with these solutions locked: one that asks for solutions of the same
    description waits for nobody, since the lock is its own thread's.
    """

    def __init__(self, find: Callable[[], Iterator[Solution]]) -> None:
        """Begins with none.

        Args:
            find: gives the solutions; called again when it failed, and then the first ones are skipped.
        """
        self._lock = threading.RLock()
        self._find = find
        self._found: Iterator[Solution] | None = None
        self._kept: list[Solution] = []

    def at(self, index: int) -> Solution | None:
        """A solution.

        Args:
            index: its number, from 0.

        Returns:
            The solution, None if there are fewer.
        """
        with self._lock:
            while len(self._kept) <= index:
                if self._found is None:  # at first, and after an error: then what was found already is skipped
                    self._found = itertools.islice(self._find(), len(self._kept), None)
                try:
                    solution = next(self._found, None)
                except BaseException:
                    self._found = None
                    raise
                if solution is None:
                    return None
                self._kept.append(solution)
            return self._kept[index]
