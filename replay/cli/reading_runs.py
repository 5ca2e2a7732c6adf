"""Folders of recordings for verbs: opened with a line of progress, and words that several verbs print."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from replay.runs.runs import Runs

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.runs.statistics import Share

_PROGRESS_PERIOD: Final = 1.0  # s without a line of progress


@contextmanager
def opened(path: str) -> Iterator[Runs]:
    """Open a folder; a terminal shows how far it is."""
    began, shown = time.monotonic(), False

    def progress(done: int, of: int) -> None:
        nonlocal shown
        if sys.stderr.isatty() and time.monotonic() - began > _PROGRESS_PERIOD:
            shown = True
            print(f"\rpycram-replay: reading recordings: {done} of {of}", end="", file=sys.stderr, flush=True)

    runs = Runs(path, progress)
    if shown:
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)
    with runs:
        yield runs


def percent(share: float) -> str:
    """Return a share in words."""
    return f"{share:.0%}" if share in (0, 1) or 0.01 <= share <= 0.99 else f"{share:.1%}"


def success(share: Share) -> str:
    """Return how many of some runs succeeded, with the interval."""
    low, high = share.interval
    rate = percent(share.succeeded / share.of) if share.of else "none"
    return f"{share.succeeded} of {share.of} succeeded, {rate} (95 %: {percent(low)} to {percent(high)})"


def plural(count: int, what: str) -> str:
    """Return how many there are of something."""
    return f"{count} {what}{'' if count == 1 else 's'}"
