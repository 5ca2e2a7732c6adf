"""Python's clocks, which stand still while a plan is stopped: else its deadlines would pass at the prompt."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_CLOCKS: Final = ("time", "monotonic", "perf_counter")
_NS: Final = 10**9


class StandingClock:
    """Stands in for Python's clocks in this process, from :meth:`install` on."""

    def __init__(self) -> None:
        self._now_ns = time.monotonic_ns
        self._stood_ns = 0

    def install(self) -> None:
        """Have the functions of ``time`` tell the time without that in which the plan stood still."""
        for name in _CLOCKS:
            setattr(time, f"{name}_ns", self._without(getattr(time, f"{name}_ns")))
            setattr(time, name, self._in_seconds(getattr(time, name)))

    @contextmanager
    def standing(self) -> Iterator[None]:
        """Stop the clocks while the block runs, also where it goes on in a forked child."""
        since = self._now_ns()
        try:
            yield
        finally:
            self._stood_ns += self._now_ns() - since

    def _without(self, clock: Callable[[], int]) -> Callable[[], int]:
        return lambda: clock() - self._stood_ns

    def _in_seconds(self, clock: Callable[[], float]) -> Callable[[], float]:
        return lambda: clock() - self._stood_ns / _NS
