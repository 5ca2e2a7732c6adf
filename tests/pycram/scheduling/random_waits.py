"""Random plans whose branches wait: those that are in a deadlock, and those that something from outside wakes."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING

from pycram.bullet_world import BulletWorld, Object
from pycram.event import Event
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.fluents.world import contact
from pycram.language import finally_, in_thread, par, pursue, seq, timeout, try_all
from pycram.scheduling.cancellation import checkpoint

if TYPE_CHECKING:
    from collections.abc import Callable


class Waits:
    """A random plan; its branches wait for each other, or for what nobody does."""

    def __init__(self, seed: int) -> None:
        self.dice = random.Random(seed)
        self.ends: list[Callable[[], object]] = []  # wait for what it has started
        self.cycle = 0  # number of branches that wait for each other

    def deadlock(self) -> Callable[[], None]:
        """Return a plan that runs into a deadlock."""
        dice = self.dice
        waits = dice.choice([self.chain, self.futures, self.forgotten, self.forgotten, self.in_the_air])()
        others = [self.work for _ in range(dice.randrange(3))]
        return lambda: self.run([*waits, *others], depth=dice.randrange(3))

    def run(self, branches: list[Callable[[], object]], depth: int) -> None:
        """Run branches in a block, which may be within other blocks."""
        if depth:
            self.dice.choice([par, seq, pursue, try_all])(lambda: self.run(branches, depth - 1))
        else:
            par(*self.dice.sample(branches, len(branches)))

    def work(self) -> None:
        """Take turns, and end."""
        for _ in range(self.dice.randrange(4)):
            checkpoint()

    def end(self) -> None:
        """Wait for the ends of the threads and processes that it has started."""
        for end in self.ends:
            end()

    def chain(self) -> list[Callable[[], object]]:
        """Hold a fluent each, and wait until the next one is free."""
        self.cycle = number = self.dice.randrange(2, 6)
        held = [Fluent("free", f"held {index}") for index in range(number)]
        together = Fluent(0, "together")

        def hold(index: int) -> None:
            held[index].set_value(index)
            together.set_value(together.get_value() + 1)
            (together == number).wait_for()
            (held[(index + 1) % number] == "free").wait_for()
            held[index].set_value("free")

        return [partial(hold, index) for index in range(number)]

    def futures(self) -> list[Callable[[], object]]:
        """Wait for each other's results."""
        self.cycle = number = self.dice.randrange(2, 5)
        known: list[object] = []

        def cycle() -> None:
            with par as s:
                known.extend(s(lambda index=index: known[(index + 1) % number].result()) for index in range(number))

        return [cycle]

    def forgotten(self) -> list[Callable[[], object]]:
        """Wait for what nobody does; a cleanup may do so as well."""
        dice = self.dice
        fluent = Fluent(name="forgotten")
        waits = [fluent.wait_for, (fluent > 3).wait_for, fluent.pulsed().wait_for, fluent.rising().wait_for,
                 (fluent == 1).AND(fluent != 2).wait_for]  # fmt: skip

        def clean() -> None:
            with finally_(lambda: Fluent(name="cleanup").wait_for()):
                fluent.wait_for()

        return [dice.choice([*waits, clean]) for _ in range(dice.randrange(1, 5))]

    def in_the_air(self) -> list[Callable[[], object]]:
        """Wait for a thing to fall that nobody simulates."""

        world = BulletWorld()
        self.ends.append(world.exit)
        return [contact(*self.falling_onto(world)).wait_for]

    # --- plans that something wakes --------------------------------------------------------------------------------

    def woken(self, asleep: threading.Event) -> None:
        """Wait for a fluent that something from outside of the branches sets; ``asleep`` is set when the thread sleeps."""
        answer = Fluent(name="answer")
        wakers = (self.clock, self.limit, self.thread, self.pool, self.worker, self.alarm, self.event,
                  self.process, self.real_time, self.simulated_limit, self.falling)  # fmt: skip
        waits = self.dice.choices([answer.wait_for, (answer == 1).wait_for], k=self.dice.randrange(1, 4))
        others = [self.work] * self.dice.randrange(3)
        self.run([*waits, *others, partial(self.dice.choice(wakers), answer, asleep)], self.dice.randrange(3))

    def clock(self, answer: Fluent, _: threading.Event) -> None:
        assert not Fluent().wait_for(timeout=0.003)
        answer.set_value(1)

    def limit(self, answer: Fluent, _: threading.Event) -> None:
        try:
            with timeout(0.003):
                Fluent().wait_for()
        except PlanFailure:
            answer.set_value(1)

    def simulated_limit(self, answer: Fluent, _: threading.Event) -> None:
        with BulletWorld() as world:
            try:
                with timeout(0.2, simulated=True):
                    Fluent().wait_for()
            except PlanFailure:
                assert world.sim_step == 48
                answer.set_value(1)

    def falling(self, answer: Fluent, _: threading.Event) -> None:
        with BulletWorld() as world:
            bodies = self.falling_onto(world)
            par(contact(*bodies).wait_for, lambda: world.simulate(0.3))
        answer.set_value(1)

    def falling_onto(self, world: BulletWorld) -> list[Object]:
        world.set_gravity([0, 0, -9.81])
        floor = Object("floor", "environment", "plane.urdf", world=world)
        return [floor, Object("cup", "cup", "cup.stl", [0, 0, 0.15], world=world)]

    def event(self, answer: Fluent, asleep: threading.Event) -> None:
        rings = Event("rings")
        rings += lambda: answer.set_value(1)
        self.thread(answer, asleep, rings.fire)

    def thread(self, answer: Fluent, asleep: threading.Event, act: Callable[[], object] | None = None) -> None:
        thread = threading.Thread(target=lambda: (asleep.wait(), (act or partial(answer.set_value, 1))()))
        thread.start()
        self.ends.append(thread.join)

    def pool(self, answer: Fluent, asleep: threading.Event) -> None:
        pool = ThreadPoolExecutor(1)
        pool.submit(lambda: (asleep.wait(), answer.set_value(1)))
        self.ends.append(pool.shutdown)

    def worker(self, answer: Fluent, asleep: threading.Event) -> None:
        answer.set_value(1 if in_thread(asleep.wait) else None)

    def alarm(self, answer: Fluent, _: threading.Event) -> None:
        signal.signal(signal.SIGALRM, lambda *_: answer.set_value(1))
        signal.setitimer(signal.ITIMER_REAL, 0.003)

    def process(self, answer: Fluent, _: threading.Event) -> None:
        signal.signal(signal.SIGALRM, lambda *_: answer.set_value(1))
        code = f"import os; os.kill({os.getpid()}, {int(signal.SIGALRM)})"
        self.ends.append(subprocess.Popen([sys.executable, "-SIc", code]).wait)

    def real_time(self, answer: Fluent, _: threading.Event) -> None:
        with BulletWorld() as world:
            bodies = self.falling_onto(world)
            world.set_realtime(True)
            contact(*bodies).wait_for()
        answer.set_value(1)
