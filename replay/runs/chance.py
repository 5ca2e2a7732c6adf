"""How surprising it is that something is true of so many failures, where very much is compared.

The failures are dealt anew to the runs at random, many times; each time the strongest evidence of all facts is kept:
what chance alone would find (Westfall and Young 1993, "Resampling-based multiple testing", the single-step maximum).
Facts that are true of nearly the same runs, as the ranges of a number, so count little more than one of them, and no
claim is made without a cause in more than the share of folders that is asked for.

The evidence is the log-likelihood ratio of two shares of failures against one (the G-test's statistic, halved).
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Iterable

Truth = NDArray[np.bool_]
Runs = NDArray[np.intp]

_ROUNDS: Final = 1000
_LEAST: Final = 200  # rounds, if there are many facts of many runs
_WORK: Final = 2e10  # multiplications at most
_ROWS: Final = 1000  # facts that are looked at together


def evidence(true: Truth, failed: Truth) -> NDArray[np.float64]:
    """Return how strongly facts go along with failing; 0 where failures are no more than elsewhere.

    Args:
        true: a fact in each row, a run in each column.
        failed: of these runs, which did; in further columns, which did in further rounds.
    """
    count, inside = true.shape[1], true.sum(axis=1, dtype=np.int64)[:, None]
    labels = failed.reshape(count, -1)
    failures = labels.sum(axis=0, dtype=np.int64)[None, :]
    hits = np.rint(true.astype(np.float32) @ labels.astype(np.float32)).astype(np.int64)
    counts = np.arange(count + 1, dtype=np.float64)
    log = counts * np.log(np.maximum(counts, 1))  # n log n
    cells = log[hits] + log[inside - hits] + log[failures - hits] + log[count - inside - failures + hits]
    margins = log[inside] + log[count - inside] + log[failures] + log[count - failures]
    ratio: NDArray[np.float64] = np.where(hits * count > failures * inside, cells - margins + log[count], 0.0)
    return ratio


class Chance:
    """The strongest evidence that is found where failures are dealt at random.

    Args:
        facts: which are compared: each the numbers of the runs in which something is known, and a row for each fact.
        failed: which runs did.
    """

    def __init__(self, facts: Iterable[tuple[Runs, Truth]], failed: Truth) -> None:
        alike: dict[bytes, list[tuple[Runs, Truth]]] = defaultdict(list)
        for known, true in facts:
            alike[known.tobytes()].append((known, true))
        groups = [
            (each[0][0], np.unique(np.concatenate([true for _, true in each]), axis=0)) for each in alike.values()
        ]
        work = sum(true.size for _, true in groups)
        rounds = int(min(_ROUNDS, max(_LEAST, _WORK / max(work, 1))))
        dice = np.random.default_rng(0)  # the same answer each time
        dealt = dice.permuted(np.tile(failed, (rounds, 1)), axis=1).T
        strongest: NDArray[Any] = np.zeros(rounds)
        for known, true in groups:
            for start in range(0, len(true), _ROWS):
                found = evidence(true[start : start + _ROWS], dealt[known])
                np.maximum(strongest, found.max(axis=0), out=strongest)
        self._strongest = np.sort(strongest)

    def of(self, strength: float) -> float:
        """Return how likely it is that chance alone finds a fact with so much evidence among all."""
        as_strong = len(self._strongest) - int(np.searchsorted(self._strongest, strength - 1e-9))
        return (1 + as_strong) / (1 + len(self._strongest))
