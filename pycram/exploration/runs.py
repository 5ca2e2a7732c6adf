"""Runs of a plan in processes of their own, each in an order that is asked for, as many at once as there are cores.

The processes are forked from this one, which has only imported what plans import: so a run costs what the plan costs.
"""

from __future__ import annotations

import json
import os
import signal
import time
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy.random  # noqa: F401  to be seeded in each run, which else would import it again

from pycram.exploration.ending import DIED, TIME_LIMIT, Ending, EndingSink
from pycram.projection.child import Child, usable_cores, wait
from pycram.scheduling.order import Made, Precedence, Standing
from pycram.scheduling.schedule import scheduler
from recorder.mcap.sink import McapSink
from recorder.provenance import metadata
from recorder.recording import redirected

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping

    from recorder.records import Run as RunRecord
    from recorder.tracing.journal import Sink

#: Runs the plan in an order, given as text, and records it; raises nothing.
Runner: TypeAlias = "Callable[[str, Path], object]"

_GRACE: Final = 5.0  # s that a plan has to end after it was interrupted


@dataclass(frozen=True, slots=True)
class Attempt:
    """One run.

    Attributes:
        order: The order that was asked for.
        ending: How it ended.
        turns: How many there were with two or more branches to choose from.
        made: What its order was, as exceptions from the ranks of branches.
        seconds: How long it took.
    """

    order: str
    ending: Ending
    turns: int
    made: tuple[Made, ...]
    seconds: float

    @property
    def precedences(self) -> tuple[Precedence, ...]:
        """What its order was."""
        return tuple([each.precedence for each in self.made])


class Runs:
    """Runs a plan again and again.

    Args:
        run: Runs it once.
        limit: Seconds by the clock after which a run is interrupted.
    """

    def __init__(self, run: Runner, limit: float) -> None:
        self._run = run
        self._limit = limit
        self.cores = usable_cores()

    def all(self, orders: Iterable[str], file: Path | None = None) -> Generator[tuple[int, Attempt], None, None]:
        """Run it in several orders at once; yield each with its index, as they end. None outlives the iteration."""
        waiting = list(enumerate(orders))[::-1]
        running: dict[int, _Process] = {}
        try:
            while waiting or running:
                while waiting and len(running) < self.cores:
                    index, order = waiting.pop()
                    running[index] = _Process(partial(_attempt, self._run, order, file), order, self._limit)
                wait([each.child for each in running.values()], min(each.time_left() for each in running.values()))
                for index, process in list(running.items()):
                    if process.ended():
                        del running[index]
                        yield index, process.attempt()
        finally:
            for process in running.values():
                process.child.kill()


class _Process:
    """A run that goes on."""

    def __init__(self, answer: Callable[[], bytes], order: str, limit: float) -> None:
        self._order = order
        self._limit = limit
        self._interrupted = 0.0  # when
        self.child = Child(answer)

    def time_left(self) -> float:
        """Return the seconds until something has to be done about it."""
        end = self._interrupted + _GRACE if self._interrupted else self.child.began + self._limit
        return max(0.0, end - time.monotonic())

    def ended(self) -> bool:
        """Return whether it has; one that takes too long is interrupted, and then killed."""
        if not self.child.ended and self.time_left() <= 0:
            if self._interrupted:
                self.child.kill()
            else:
                self._interrupted = time.monotonic()
                os.kill(self.child.pid, signal.SIGTERM)
        return self.child.ended

    def attempt(self) -> Attempt:
        """Return what has come of it."""
        seconds = time.monotonic() - self.child.began
        late = Ending(TIME_LIMIT, f"it still ran after {self._limit:g} s")
        if not self.child.received:
            signalled, code = self.child.signal, os.waitstatus_to_exitcode(self.child.status)
            how = f"its process was ended by {signalled}" if signalled else f"its process ended with {code}"
            return Attempt(self._order, late if self._interrupted else Ending(DIED, how), 0, (), seconds)
        answer: Mapping[str, Any] = json.loads(self.child.received)
        return Attempt(
            self._order,
            late if self._interrupted else Ending(**answer["ending"]),
            answer["turns"],
            tuple(
                Made(Precedence(*own), Standing(*first), Standing(*second), [Precedence(*each) for each in passed])
                for own, first, second, passed in answer["made"]
            ),
            seconds,
        )


def _attempt(run: Runner, order: str, file: Path | None) -> bytes:
    """Run the plan, in a child; what it records itself is not."""
    process = os.getpid()
    path = file or Path(os.devnull)
    sinks: list[EndingSink] = []

    def sink_of(began: RunRecord) -> Sink | None:
        if os.getpid() != process:  # a projection has a recording of its own
            return None
        sinks.append(EndingSink(McapSink(path, metadata(began)) if file is not None and not sinks else None))
        return sinks[-1]

    with redirected(sink_of):
        run(order, path)
    ending = sinks[0].ending if sinks else Ending(DIED, "it couldn't be recorded")
    asked = scheduler().order
    turns, made = (0, []) if asked is None else (asked.turns, asked.made)
    return json.dumps({"ending": asdict(ending), "turns": turns, "made": made}).encode()
