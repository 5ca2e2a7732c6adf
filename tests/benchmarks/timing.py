"""How the benchmarks measure on machines that are noisy, and that change their pace from one second to the next."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING

from pycram.world import simulation

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest

    from pycram.bullet_world import BulletWorld

PATIENCE = 3  # times as many rounds
LONG = 0.5  # s: noise is a small share of what takes longer
ROOM = 5  # times a goal: what neighbours on the machine do to a share of the processor's time stays below


def beside_others() -> bool:
    """Return whether other tests run at the same time, as in ``make test``: figures aren't looked at so closely then."""
    return "PYTEST_XDIST_WORKER" in os.environ


def amount(measured: int, tried: int) -> int:
    """Return how many times something is done: as often as a good figure takes, or, beside other tests, as a rough one."""
    return tried if beside_others() else measured


def warm_up(action: Callable[[], object]) -> None:
    """Do what is done faster the second time: files are laid out, code compiled. Not for rough figures."""
    if not beside_others():
        action()


def seconds(action: Callable[[], object]) -> float:
    """Processor time of this process, of all its threads: others on the machine don't count."""
    start = time.process_time()
    action()
    return time.process_time() - start


def goal(what: str, value: float, most: float, room: float = ROOM) -> None:
    """Print a figure beside its goal, and whether it misses it.

    Asserted is with so much room that no busy neighbour can break it, but something that grew with the square of
    another does.

    Args:
        what: what the figure is of.
        value: a ratio within this run.
        most: the goal.
        room: how many times the goal it may be; infinity where the clock or the scheduler has its say.
    """
    print(f"{what}: {value:.3g}, goal {most:g}{', MISSED' if value > most else ''}")
    assert value < room * most, what


def settlings(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, int]]:
    """Return what gets the seconds and the simulated steps of each settling from now on."""
    settled: list[tuple[float, int]] = []
    settle = simulation.settle

    def timed(world: BulletWorld, steps: int) -> object:
        found: list[object] = []
        before = world.sim_step
        took = seconds(lambda: found.append(settle(world, steps)))
        settled.append((took, world.sim_step - before))
        return found[0]

    monkeypatch.setattr(simulation, "settle", timed)
    return settled


def ratio(action: Callable[[], float], unit: Callable[[], float], rounds: int = 5, most: float = float("inf")) -> float:
    """What one costs in terms of the other; both tell their own seconds.

    They take turns, and the fastest of each are compared, since noise only adds. While the ratio is above `most` there are
    more rounds, as a fast moment that only one of the two met is no cost of the other. Beside other tests there are two
    rounds, and one of what takes long.
    """
    patience = PATIENCE
    if beside_others():
        rounds, patience = min(rounds, 2), 1
    actions: list[float] = []
    units: list[float] = []
    while len(actions) < rounds or (min(actions) / min(units) > most and len(actions) < rounds * patience):
        units.append(unit())
        actions.append(action())
        if beside_others() and units[0] + actions[0] > LONG:
            break
    return min(actions) / min(units)
