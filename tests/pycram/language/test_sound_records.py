"""Whatever a plan does first, last or between in nested blocks, its recording is sound."""

from __future__ import annotations

import contextlib
import random
from typing import TYPE_CHECKING

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure, RunsEarly
from pycram.fluent import Fluent
from pycram.language import par, pursue, seq, try_all, try_in_order
from pycram.running import seed as set_seed
from replay.state.integrity import verify_static
from tests.measures import seeded

if TYPE_CHECKING:
    from pathlib import Path

BLOCKS = (par, seq, pursue, try_all, try_in_order)


class RandomPlan:
    """Nested blocks, with changes of a world and a fluent as plain Python and as actions of the blocks."""

    def __init__(self, seed: int) -> None:
        self.draw = random.Random(seed)
        self.world = BulletWorld()
        self.milk = Object("milk", "milk", "milk.stl", [0, 0, 1])
        self.fluent = Fluent(0, "fluent")

    def change(self) -> None:
        kind = self.draw.randrange(4)
        if kind == 0:
            self.milk.set_position([self.draw.random(), 0, 1])
        elif kind == 1:
            self.milk.set_color([self.draw.random(), 0, 0, 1])
        elif kind == 2:
            self.fluent.set_value(self.draw.random())
        else:
            raise PlanFailure("drawn")

    def quietly(self) -> None:
        try:
            self.change()
        except (PlanFailure, RunsEarly):
            print("it failed")

    def block(self, depth: int) -> None:
        with self.draw.choice(BLOCKS) as actions:
            for _ in range(self.draw.randrange(1, 4)):
                kind = self.draw.randrange(4)
                if kind == 0 and depth:
                    self.block(depth - 1)
                elif kind == 1:
                    actions(self.change)
                else:
                    self.quietly()

    def run(self) -> None:
        with self.world:
            for _ in range(2):
                with contextlib.suppress(PlanFailure, RunsEarly):
                    self.block(3)


@seeded("recordings of nested blocks are sound", range(1000), 25)
def test_plans_of_nested_blocks_leave_sound_records(seeds: range, tmp_path: Path) -> None:
    for seed in seeds:
        set_seed(seed)
        file = tmp_path / f"{seed}.mcap"
        with recorder.record(file, output=True):
            RandomPlan(seed).run()
        with replay.open(file) as log:
            verification = verify_static(log)
        assert verification.sound, (seed, verification.problem)
