"""Makes what decides small: of the many precedences that an order has, those few without which the plan ends otherwise.

Delta debugging (Zeller, Hildebrandt: Simplifying and isolating failure-inducing input, IEEE TSE 2002), with several
tries at once. The result is 1-minimal: without any one of its precedences the ending is another one.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final

from pycram.scheduling.order import text_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.exploration.ending import Ending
    from pycram.exploration.runs import Attempt, Runs
    from pycram.scheduling.order import Precedence

_MAX_TRIES: Final = 200  # tries


class _Tries:
    """Tries whether precedences lead to an ending; each once."""

    def __init__(self, runs: Runs, ending: Ending) -> None:
        self._runs = runs
        self._ending = ending
        self._known: dict[tuple[Precedence, ...], Attempt] = {}

    def first_of(self, tries: Sequence[Sequence[Precedence]]) -> Attempt | None:
        """Return the first run that ends so, as many at once as there are cores; None if there is none."""
        for start in range(0, len(tries), self._runs.cores):
            wave = [tuple(each) for each in tries[start : start + self._runs.cores]]
            new = [each for each in wave if each not in self._known][: _MAX_TRIES - len(self._known)]
            for index, attempt in self._runs.all([text_of(each) for each in new]):
                self._known[new[index]] = attempt
            for each in wave:
                if each in self._known and self._known[each].ending.is_like(self._ending):
                    return self._known[each]
        return None


def reduced(runs: Runs, precedences: Sequence[Precedence], ending: Ending) -> Attempt | None:
    """Return a run with the least precedences that were found to lead to an ending.

    Args:
        runs: Runs the plan.
        precedences: What leads to it.
        ending: The ending.

    Returns:
        None if these themselves don't lead to it: the plan isn't deterministic.
    """
    tries = _Tries(runs, ending)
    best = tries.first_of([precedences])
    parts = 2
    while best is not None and parts <= len(best.precedences):
        least = best.precedences
        cuts = [len(least) * part // parts for part in range(parts + 1)]
        chunks = [(least[:a], least[a:b], least[b:]) for a, b in pairwise(cuts)]
        some = tries.first_of([chunk for _, chunk, _ in chunks])
        rest = some or tries.first_of([(*before, *after) for before, _, after in chunks])
        if rest is None:
            parts = len(least) if parts < len(least) else parts + 1
        else:
            best, parts = rest, 2 if some else max(parts - 1, 2)
    return best and _nearer(tries, best)


def _nearer(tries: _Tries, best: Attempt) -> Attempt:
    """Return a run in which branches go before as few others as possible."""
    for at in range(len(best.made)):
        made = best.precedences
        found = tries.first_of([(*made[:at], passed, *made[at + 1 :]) for passed in best.made[at].passed])
        if found is not None and len(found.made) == len(made):
            best = found
    return best
