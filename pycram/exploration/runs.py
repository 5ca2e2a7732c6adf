"""Runs of a plan in processes of their own, each in an order that is asked for, as many at once as there are cores.

The processes are forked from this one, which has only imported what plans import: so a run costs what the plan costs.
"""

from __future__ import annotations

import json
import os
import time
from collections import deque
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy.random  # noqa: F401  to be seeded in each run, which else would import it again

from pycram.exploration.ending import DIED, TIME_LIMIT, Ending, EndingSink
from pycram.projection.child import usable_cores
from pycram.projection.limited import Several
from pycram.scheduling.order import Made, Precedence, Standing
from pycram.scheduling.schedule import scheduler
from recorder.mcap.sink import McapSink
from recorder.provenance import metadata
from recorder.recording import redirected

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping

    from pycram.projection.limited import LimitedChild
    from recorder.records import Run as RunRecord
    from recorder.tracing.journal import Sink

#: Runs the plan in an order, given as text, and records it; raises nothing.
Runner: TypeAlias = "Callable[[str, Path], object]"


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
        self.cores = usable_cores()
        self._several: Several[tuple[int, str]] = Several(self.cores, limit)

    def all(self, orders: Iterable[str], file: Path | None = None) -> Generator[tuple[int, Attempt], None, None]:
        """Run it in several orders at once; yield each with its index, as they end. None outlives the iteration."""

        def answer_of(job: tuple[int, str]) -> Callable[[], bytes]:
            return partial(_attempt, self._run, job[1], file)

        with closing(self._several.run(deque(enumerate(orders)), answer_of)) as ended:
            for (index, order), process in ended:
                yield index, self._attempt_of(order, process)

    def _attempt_of(self, order: str, process: LimitedChild) -> Attempt:
        """Return what has come of a run."""
        seconds = time.monotonic() - process.child.began
        late = Ending(TIME_LIMIT, f"it still ran after {self._several.limit:g} s")
        if not process.child.received:
            return Attempt(order, late if process.late else Ending(DIED, process.how), 0, (), seconds)
        answer: Mapping[str, Any] = json.loads(process.child.received)
        return Attempt(
            order,
            late if process.late else Ending(**answer["ending"]),
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
