"""What a person waits for at the debugger's prompt over the demo, and what the copies that wait there take: printed."""

from __future__ import annotations

import os
import statistics
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import replay
from replay.debug.guided_plan import GuidedPlan
from replay.debug.session import Session
from replay.retrace.plan_process import PlanProcess
from tests.benchmarks.timing import goal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytestmark = [pytest.mark.slow, pytest.mark.long]

NO_LIMIT = float("inf")  # where other processes of the machine have their say


@pytest.fixture(scope="module")
def run(recorded_demo: Callable[[str], Path]) -> Iterator[tuple[Session, float]]:
    """A session that has come to the end, and the seconds of its way there."""
    with replay.open(recorded_demo("set_the_table")) as log, GuidedPlan(PlanProcess(log)) as plan:
        session = Session(log, plan)
        yield session, waited(lambda: session.go(last(session)))


def last(session: Session) -> int:
    """The last step before the world is closed."""
    return len(session.log) - 2


def waited(action: Callable[[], object]) -> float:
    """Seconds by the clock: what is waited for is done by other processes."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def descendants(process: int) -> Iterator[int]:
    for child in Path(f"/proc/{process}/task/{process}/children").read_text().split():
        yield int(child)
        yield from descendants(int(child))


def private_megabytes(process: int, field: str) -> float:
    """Memory of a process that belongs to no file."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith(f"{field}:")) / 1000


def test_going_back_in_the_demo(run: tuple[Session, float]) -> None:
    session, whole = run
    session.go(last(session))
    plan = sorted(descendants(os.getpid()), key=lambda each: private_megabytes(each, "Anonymous"))
    copies = len(session.plan.copies.checkpoints())
    alone = private_megabytes(plan[-1], "Anonymous")
    each = (sum(private_megabytes(process, "Pss_Anon") for process in plan) - alone) / copies
    print(f"\n{copies} copies of a plan of {alone:.0f} MB: {each:.1f} MB each")
    goal("a copy, MB", each, 20)

    steps = [waited(lambda: session.back(session.step - 1)) for _ in range(100)]
    median = statistics.median(steps)
    print(f"to the end {whole:.1f} s; rstep: median {median * 1e3:.0f} ms, longest {max(steps) * 1e3:.0f} ms")
    goal("rstep, ms", median * 1e3, 200, room=NO_LIMIT)
    goal("rstep, of the whole run", median / whole, 1 / 20)


def test_going_back_to_a_watch_in_the_demo(run: tuple[Session, float]) -> None:
    session, whole = run
    session.go(last(session))
    watch = session.set_watch("milk.z", 0)
    recorded = [waited(session.back) for _ in range(4)]
    assert session.step in watch.steps
    watch.enabled = False
    session.go(last(session) - 8)  # in the last call of move_object
    frame = next(number for number, each in enumerate(session.plan.ask("where")) if each["function"] == "move_object")
    session.set_watch("object_type", frame)
    variable = waited(session.back)
    each = ", ".join(f"{seconds:.2f}" for seconds in recorded)
    print(f"\nrcontinue to a change of milk.z: {each} s; of a variable: {variable:.2f} s, to the end {whole:.1f} s")
    goal("rcontinue to a watch, s", statistics.median(recorded), 2, room=NO_LIMIT)
    goal("rcontinue to a watched variable, s", variable, 2, room=NO_LIMIT)
    goal("rcontinue to a watched variable, of the whole run", variable / whole, 1)
