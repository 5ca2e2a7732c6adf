"""Runs random concurrent plans and prints a digest of the records of each: ``random_orders.py SEED PLAN...``."""

from __future__ import annotations

import hashlib
import random
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.language import failure_handling, finally_, par, pursue, seq, timeout, try_all, try_in_order
from pycram.scheduling.cancellation import checkpoint
from pycram.scheduling.schedule import scheduler, seed_order
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Callable

    from recorder.records import Record

TICKS = 12
CLOCKS = ("wall_time_ns", "monotonic_ns", "duration_ns")


class Digest:
    """A sink that hashes records, but for what clocks and counters of the process tell."""

    def __init__(self) -> None:
        self.hash = hashlib.sha256()
        self.first_task = 0
        self.lines: list[str] = []

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        copy = type(record).FromString(payload)
        for clock in CLOCKS:
            if clock in copy.DESCRIPTOR.fields_by_name:
                copy.ClearField(clock)
        self.first_task = self.first_task or copy.task
        for field in ("task", "parent"):  # ids count over the process
            if getattr(copy, field, 0):
                setattr(copy, field, getattr(copy, field) - self.first_task)
        self.lines.append(f"{topic} {copy}")
        self.hash.update(copy.SerializeToString(deterministic=True))

    def attach(self, asset: object) -> None:
        """Models are the same for all."""

    def flush(self) -> None:
        """Nothing waits."""

    def close(self) -> None:
        """Nothing is open."""


class Plan:
    """A random plan of blocks, waits, failures, changes and simulated time."""

    def __init__(self, number: int, world: BulletWorld) -> None:
        self.dice = random.Random(number)
        self.world = world
        self.ticks = Fluent(0, "ticks")
        self.things = [Object(f"cup {i}", "cup", "cup.stl", [i, 0, 1], world=world) for i in range(3)]

    def run(self) -> None:
        with suppress(PlanFailure), par as s:
            s(self.tick)
            for _ in range(self.dice.randrange(2, 4)):
                s(self.part(3))

    def tick(self) -> None:
        for number in range(TICKS):
            checkpoint()
            self.ticks.set_value(number + 1)

    def part(self, depth: int) -> Callable[[], object]:  # noqa: PLR0911  one for each sort
        """Make a part; all dice are cast before anything runs."""
        dice, what = self.dice, self.dice.random()
        if depth and what < 0.55:
            kind, parts = dice.choice((par, par, pursue, try_all, seq, try_in_order)), dice.randrange(2, 4)
            branches = [self.part(depth - 1) for _ in range(parts)]
            return lambda: kind(*branches)
        if depth and what < 0.62:
            part, limit = self.part(depth - 1), dice.choice((0.02, 0.1, 5))
            return lambda: self.within(timeout(limit, simulated=True), part)
        if depth and what < 0.68:
            part, cleaning = self.part(depth - 1), self.part(0)
            return lambda: self.within(finally_(cleaning), part)
        if depth and what < 0.74:
            part = self.part(depth - 1)
            return lambda: failure_handling(1).run(part)
        if what < 0.80:
            return self.fail
        if what < 0.86:
            number = dice.randrange(TICKS)
            return lambda: (self.ticks > number).wait_for(60)
        if what < 0.93:
            return lambda: self.world.simulate(0.02)
        thing, place = dice.choice(self.things), [dice.uniform(-9, 9) for _ in range(3)]
        return lambda: thing.set_position(place)

    def within(self, context: object, part: Callable[[], object]) -> None:
        with context:
            part()

    def fail(self) -> None:
        raise PlanFailure("no")


def digest(plan: int, seed: int) -> Digest:
    """Run a plan in an order drawn from a seed."""
    sink = Digest()
    log = journal.Journal([sink])
    journal.open_journal(log)
    seed_order(seed)
    scheduler().checkpoints = 0
    try:
        with BulletWorld(name="kitchen") as world:
            Plan(plan, world).run()
    finally:
        seed_order(None)
        journal.close_journal(log)
    return sink


if __name__ == "__main__":
    order, *plans = map(int, sys.argv[1:])
    for number in plans:
        print(number, digest(number, order).hash.hexdigest())
