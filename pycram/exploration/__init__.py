"""Exploration: a plan runs in many orders of its branches, to find those in which it ends otherwise (races).

Random numbers and the order of sets are the same in all runs, so what differs is due to the order. The first run takes
the branches as they were added, the orders of the others are drawn by :class:`~pycram.scheduling.order.Pct`. Of each
ending that isn't the first run's, what decides is made small (:mod:`pycram.exploration.reducing`), run once more, and
recorded.
"""

from __future__ import annotations

import os
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.exploration.ending import DEADLOCK, DIED, FAILED, SUCCEEDED, TIME_LIMIT, Ending
from pycram.exploration.reducing import reduced
from pycram.exploration.runs import Attempt, Runner, Runs
from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, UsageError
from pycram.foundation.names import export
from pycram.scheduling.locks import refuse_held
from pycram.scheduling.order import ADDED, Made, text_of
from pycram.scheduling.schedule import seed_order
from pycram.seeding import seed_random_numbers
from pycram.world.current import open_worlds
from recorder.errors import RecordingError
from recorder.mcap.sink import free_path
from recorder.recording import look_up_revisions, record
from recorder.tracing import forking

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

__all__ = ["DEADLOCK", "DIED", "FAILED", "SUCCEEDED", "TIME_LIMIT", "Exploration", "Found", "NotExplorable", "explore"]

DEPTH: Final = 3  # of races: most that are known need no more (Burckhardt et al.)
LIMIT: Final = 60.0  # s
_ROUND: Final = 16  # runs that draw over the same number of turns
_EXPLAINED: Final = 8  # endings; there may be as many as runs
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
class Found:
    """Runs that end alike.

    Attributes:
        ending: That of the first of them.
        count: How many they are.
        order: An order that leads there, as :mod:`pycram.scheduling.order` has it as text: the smallest that is known.
        made: What decides: these branches go before those, which else ends as the first found ending. Empty for the
            first, and where it isn't known.
        recording: The file of a run in that order; None if none was kept.
    """

    ending: Ending
    count: int
    order: str
    made: tuple[Made, ...] = ()
    recording: Path | None = None


@dataclass(slots=True)
class Exploration:
    """What running a plan in many orders has found.

    Attributes:
        runs: How many have ended.
        orders: How many of them had another order than all before.
        found: The endings; first that of the order in which branches were added, then in the order of the runs.
        deterministic: Whether those that were run twice in the same order ended alike.
        interrupted: Whether Ctrl-C ended it.
    """

    runs: int
    orders: int
    found: list[Found]
    deterministic: bool = True
    interrupted: bool = False

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
    """Do an action in many orders of its branches, each time in a copy of this process; here nothing happens.

    Args:
        action: A function of the plan.
        runs: How many orders.
        seed: Of random numbers, the same in all runs, and of the orders.
        depth: Races are found that need this many orderings of two steps, or less.
        limit: Seconds by the clock that a run may take.
        folder: Where a recording of each ending is kept if there are several; None to keep none.

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
    """Explore what a function runs; see :func:`explore`.

    Args:
        run: Runs the plan once.
        count: How many orders.
        depth: Of the races.
        limit: Seconds that a run may take.
        plan: Its file; None for the program's.
        file: Recordings are named after it, RUN.explored-1.mcap for the first ending; None to keep none.
        overwrite: Whether recordings that are there are replaced.
        progress: Called after each run with their number.
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
    several = Runs(run, limit)
    result = Exploration(0, 0, [])
    attempts: dict[int, Attempt] = {}
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


def _orders(count: int, depth: int, attempts: dict[int, Attempt]) -> Iterator[Sequence[str]]:
    """Yield the orders of each round; the longest run so far says over how many turns they are drawn."""
    yield [ADDED]
    for start in range(1, count, _ROUND):
        turns = max(attempt.turns for attempt in attempts.values())
        if not turns:  # there never was a choice
            return
        yield [f"pct:{number}:{depth}:{turns}" for number in range(start, min(start + _ROUND, count))]


def _sort(attempts: Mapping[int, Attempt], result: Exploration) -> None:
    """Find the different endings, in the order of the runs."""
    if not result.runs:  # else it is known, and what decides may be
        for _, attempt in sorted(attempts.items()):
            like = next((each for each in result.found if each.ending.is_like(attempt.ending)), None)
            if like is None:
                result.found.append(Found(attempt.ending, 1, attempt.order))
            else:
                like.count += 1
    result.runs = len(attempts)
    result.orders = len({attempt.precedences for attempt in attempts.values()})


def _decide(runs: Runs, result: Exploration, attempts: Mapping[int, Attempt]) -> None:
    """Find what decides: which few precedences make an order that ends as the first one an order that doesn't."""
    again = [each for each in result.found[:_EXPLAINED] if each.ending.kind in _TELLING] * 2
    for index, attempt in runs.all([each.order for each in again]):
        result.deterministic &= attempt.ending.is_like(again[index].ending)
    for found in result.found[1:_EXPLAINED] if result.deterministic else ():
        if found.ending.kind in _TELLING:
            of_it = [each for each in attempts.values() if each.ending.is_like(found.ending)]
            shortest = min(of_it, key=lambda attempt: len(attempt.made))
            least = reduced(runs, shortest.precedences, found.ending)
            if least is None:
                result.deterministic = False
                return
            found.order = text_of(least.precedences)


def _run_again(runs: Runs, result: Exploration, file: Path | None, *, overwrite: bool) -> None:
    """Run the smallest order of each ending once more, for where its branches stand, and to record it."""
    for number, found in enumerate(result.found[:_EXPLAINED], 1):
        name = None if file is None else file.with_name(f"{file.stem}.explored-{number}{file.suffix}")
        if name is not None and not overwrite:
            name = free_path(name)
        ((_, attempt),) = runs.all([found.order], name)
        if not attempt.ending.is_like(found.ending):
            result.deterministic = False
        found.recording = name
        found.made = attempt.made if found.order.startswith(ADDED) else ()
