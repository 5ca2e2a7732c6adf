"""Exploration: a plan runs in many orders of its branches, to find orders with another ending (races).

Random numbers and the order of sets are the same in all runs, so differences are due to the order. The first run takes
the branches as they were added; :class:`~pycram.scheduling.order.Pct` draws the other orders. For each other ending,
the deciding precedences are reduced to a minimum, run once more, and recorded.

The reduction is delta debugging (Zeller, Hildebrandt: Simplifying and isolating failure-inducing input, IEEE TSE 2002),
with several tries in parallel. The result is 1-minimal: without any one of its precedences the ending is another one.
"""

from __future__ import annotations

import os
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.exploration.runs import (
    DEADLOCK,
    DIED,
    FAILED,
    SUCCEEDED,
    TIME_LIMIT,
    Ending,
    OrderedRun,
    PlanRunner,
    Runner,
)
from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, UsageError
from pycram.foundation.names import export
from pycram.scheduling.locks import refuse_held
from pycram.scheduling.order import ADDED, Made, text_of
from pycram.scheduling.schedule import seed_order
from pycram.seeding import seed_random_numbers
from pycram.world.world import open_worlds
from recorder.errors import RecordingError
from recorder.mcap_sink import free_path
from recorder.recording import look_up_revisions, record
from recorder.tracing import forking

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from pycram.scheduling.order import Precedence


__all__ = [
    "DEADLOCK",
    "DIED",
    "FAILED",
    "SUCCEEDED",
    "TIME_LIMIT",
    "EndingGroup",
    "Exploration",
    "NotExplorable",
    "explore",
]

DEPTH: Final = 3  # of races: most that are known need no more (Burckhardt et al.)
LIMIT: Final = 60.0  # s
_ROUND: Final = 16  # runs that draw over the same number of turns
_EXPLAINED: Final = 8  # endings; there may be as many as runs
_MAX_TRIES: Final = 200  # runs to reduce an order
_TELLING: Final = (SUCCEEDED, FAILED, DEADLOCK)  # kinds of endings whose runs tell what their orders were


class NotExplorable(UsageError):
    """An action was to be explored where its process can't be copied.

    Attributes:
        cause: Why not, and what to do.
    """

    def __init__(self, cause: str) -> None:
        super().__init__(f"orders can't be explored here: {cause}")
        self.cause = cause


export("pycram.exploration", NotExplorable)


@dataclass(slots=True)
class EndingGroup:
    """Runs that end alike."""

    ending: Ending  # of the first run
    count: int
    order: str  # the smallest known order with this ending, as text of :mod:`pycram.scheduling.order`
    #: The deciding precedences; without them the first ending is reached. Empty for the first ending, and if unknown.
    made: tuple[Made, ...] = ()
    recording: Path | None = None  # of a run in that order


@dataclass(slots=True)
class Exploration:
    """The results of running a plan in many orders."""

    runs: int  # number of ended runs
    orders: int  # number of different orders among them
    found: list[EndingGroup]  # in the order of the runs; the first run takes branches as they were added
    deterministic: bool = True  # whether runs in the same order ended alike
    interrupted: bool = False  # by Ctrl-C

    @property
    def alike(self) -> bool:
        """Whether all runs ended alike."""
        return len(self.found) < 2 and self.deterministic


def explore(
    action: Callable[[], object],
    runs: int = 100,
    *,
    seed: int = 0,
    depth: int = DEPTH,
    limit: float = LIMIT,
    folder: str | Path | None = None,
) -> Exploration:
    """Run an action in many orders of its branches, each time in a copy of this process; nothing changes here.

    Args:
        action: A function of the plan.
        runs: Number of orders.
        seed: Of random numbers, the same in all runs, and of the orders.
        depth: Maximum number of orderings of two steps that a race needs to be found.
        limit: Seconds of wall-clock time for each run.
        folder: For a recording of each ending, if there are several; None to keep none.

    Raises:
        NotExplorable: A world has a window or runs in real time, threads of the plan's own run, or nothing can fork.
        BadArgument: An argument is wrong.
        LockHeld: The caller holds a lock.
        RecordingError: There is no such folder.
    """
    refuse_held()
    if not callable(action):
        raise BadArgument("action", action, "a function of the plan")
    name = getattr(action, "__name__", "action")

    def run(order: str, path: Path) -> None:
        seed_random_numbers(seed)
        seed_order(seed, order)
        with (
            suppress(BaseException),  # the recording has it
            record(path, name=name, arguments=(), seed=seed, order=order, output=True, overwrite=True),
        ):
            action()

    file = None if folder is None else Path(folder) / f"{name}.mcap"
    return explore_runs(run, runs, depth=depth, limit=limit, file=file)


def explore_runs(
    run: Runner,
    count: int,
    *,
    depth: int = DEPTH,
    limit: float = LIMIT,
    plan: Path | None = None,
    file: Path | None = None,
    overwrite: bool = False,
    progress: Callable[[int], None] = lambda _: None,
) -> Exploration:
    """Explore a plan by a function that runs it; see :func:`explore`.

    Args:
        run: Runs the plan once.
        count: Number of orders.
        depth: Of the races.
        limit: Seconds of wall-clock time for each run.
        plan: Its file; None for the program's.
        file: Recordings are named after it, RUN.explored-1.mcap for the first ending; None to keep none.
        overwrite: Whether existing recordings are replaced.
        progress: Called after each run with the number of runs.
    """
    for argument, number in (("runs", count), ("depth", depth)):
        if checks.number(argument, number) != int(number) or number < 1:
            raise BadArgument(argument, number, "a whole number from 1")
    if checks.number("limit", limit) <= 0:
        raise BadArgument("limit", limit, "seconds, more than 0")
    _refuse_impossible()
    if file is not None and not file.parent.is_dir():  # else it would come out when all has run
        raise RecordingError(file, "No such file or directory", "make the folder first")
    look_up_revisions(plan)
    several = PlanRunner(run, limit)
    result = Exploration(0, 0, [])
    attempts: dict[int, OrderedRun] = {}
    try:
        for orders in _orders(count, depth, attempts):
            begun = len(attempts)
            with closing(several.all(orders)) as ended:
                for index, attempt in ended:
                    attempts[begun + index] = attempt
                    progress(len(attempts))
        _sort(attempts, result)
        if len(result.found) > 1:
            _decide(several, result, attempts)
            _run_again(several, result, file, overwrite=overwrite)
    except KeyboardInterrupt:
        _sort(attempts, result)
        result.interrupted = True
    return result


def _refuse_impossible() -> None:
    if not hasattr(os, "fork"):
        raise NotExplorable("this system can't copy a process (os.fork)")
    for world in open_worlds():
        if world.mode == "GUI" or world.realtime:
            raise NotExplorable(f"{world.name} has a window or runs in real time; open it within the action")
    if threads := [thread.name for thread in forking.others()]:
        raise NotExplorable(f"the copies would lack the threads {', '.join(threads)}; start them within the action")


def _orders(count: int, depth: int, attempts: dict[int, OrderedRun]) -> Iterator[Sequence[str]]:
    """Yield the orders of each round, drawn over as many turns as the longest run so far had."""
    yield [ADDED]
    for start in range(1, count, _ROUND):
        turns = max(attempt.turns for attempt in attempts.values())
        if not turns:  # there never was a choice
            return
        yield [f"pct:{number}:{depth}:{turns}" for number in range(start, min(start + _ROUND, count))]


def _sort(attempts: Mapping[int, OrderedRun], result: Exploration) -> None:
    """Find the different endings, in the order of the runs."""
    if not result.runs:  # else it is done
        for _, attempt in sorted(attempts.items()):
            like = next((each for each in result.found if each.ending.is_like(attempt.ending)), None)
            if like is None:
                result.found.append(EndingGroup(attempt.ending, 1, attempt.order))
            else:
                like.count += 1
    result.runs = len(attempts)
    result.orders = len({attempt.precedences for attempt in attempts.values()})


def _decide(runs: PlanRunner, result: Exploration, attempts: Mapping[int, OrderedRun]) -> None:
    """Find the few precedences that decide each ending."""
    again = [each for each in result.found[:_EXPLAINED] if each.ending.kind in _TELLING] * 2
    for index, attempt in runs.all([each.order for each in again]):
        result.deterministic &= attempt.ending.is_like(again[index].ending)
    for found in result.found[1:_EXPLAINED] if result.deterministic else ():
        if found.ending.kind in _TELLING:
            of_it = [each for each in attempts.values() if each.ending.is_like(found.ending)]
            shortest = min(of_it, key=lambda attempt: len(attempt.made))
            least = _reduced(runs, shortest.precedences, found.ending)
            if least is None:
                result.deterministic = False
                return
            found.order = text_of(least.precedences)


def _run_again(runs: PlanRunner, result: Exploration, file: Path | None, *, overwrite: bool) -> None:
    """Run the smallest order of each ending once more, to record it with the places of its branches."""
    for number, found in enumerate(result.found[:_EXPLAINED], 1):
        name = None if file is None else file.with_name(f"{file.stem}.explored-{number}{file.suffix}")
        if name is not None and not overwrite:
            name = free_path(name)
        ((_, attempt),) = runs.all([found.order], name)
        if not attempt.ending.is_like(found.ending):
            result.deterministic = False
        found.recording = name
        found.made = attempt.made if found.order.startswith(ADDED) else ()


class _Tries:
    """Tries whether precedences lead to an ending, each once."""

    def __init__(self, runs: PlanRunner, ending: Ending) -> None:
        self._runs = runs
        self._ending = ending
        self._known: dict[tuple[Precedence, ...], OrderedRun] = {}

    def first_of(self, tries: Sequence[Sequence[Precedence]]) -> OrderedRun | None:
        """Return the first run with that ending, running as many in parallel as there are cores."""
        for start in range(0, len(tries), self._runs.cores):
            wave = [tuple(each) for each in tries[start : start + self._runs.cores]]
            new = [each for each in wave if each not in self._known][: _MAX_TRIES - len(self._known)]
            for index, attempt in self._runs.all([text_of(each) for each in new]):
                self._known[new[index]] = attempt
            for each in wave:
                if each in self._known and self._known[each].ending.is_like(self._ending):
                    return self._known[each]
        return None


def _reduced(runs: PlanRunner, precedences: Sequence[Precedence], ending: Ending) -> OrderedRun | None:
    """Return a run with a minimum of given precedences that still has a given ending.

    Returns None if the run with all precedences has another ending: the plan isn't deterministic.
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


def _nearer(tries: _Tries, best: OrderedRun) -> OrderedRun:
    """Return a run in which branches precede as few others as possible."""
    for at in range(len(best.made)):
        made = best.precedences
        found = tries.first_of([(*made[:at], passed, *made[at + 1 :]) for passed in best.made[at].passed])
        if found is not None and len(found.made) == len(made):
            best = found
    return best
