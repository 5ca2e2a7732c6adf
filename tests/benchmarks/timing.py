"""How the benchmarks measure on machines that are noisy, and that change their pace from one second to the next."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

PATIENCE = 5  # times as many rounds


def seconds(action: Callable[[], object]) -> float:
    """Processor time of this process, of all its threads: others on the machine don't count."""
    start = time.process_time()
    action()
    return time.process_time() - start


def ratio(action: Callable[[], float], unit: Callable[[], float], rounds: int = 5, most: float = float("inf")) -> float:
    """What one costs in terms of the other; both tell their own seconds.

    They take turns, and the fastest of each are compared, since noise only adds. While the ratio is above `most` there are
    more rounds, as a fast moment that only one of the two met is no cost of the other.
    """
    actions: list[float] = []
    units: list[float] = []
    while len(actions) < rounds or (min(actions) / min(units) > most and len(actions) < rounds * PATIENCE):
        units.append(unit())
        actions.append(action())
    return min(actions) / min(units)
