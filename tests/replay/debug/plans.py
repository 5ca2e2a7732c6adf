"""A plan with branches, variables, random numbers, an event, a fluent and a failure, and its recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.replay.retrace.test_retrace import record

if TYPE_CHECKING:
    from pathlib import Path

TEXT = """\
import random
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.event import Event
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.language import par, failure_handling

def lift(body, heights):
    lifted = 0
    for height in heights:
        lifted += 1
        body.set_position([0, 0, height])
    return lifted

def lift_cup():
    lift(cup, [0.4, 0.6])

def paint():
    shade = random.random()
    milk.set_color([shade, 0, 0, 1])

def insist(times):
    for attempt in failure_handling(3):
        with attempt:
            if attempt.number <= times:
                raise PlanFailure("not yet")

world = BulletWorld()
milk = Object("milk", "milk", "milk.stl", [0, 0, 0.2])
cup = Object("cup", "cup", "cup.stl", [1, 0, 0.2])
rung = Event("rung")
level = Fluent(1, name="level")
print("begin")
total = lift(milk, [0.5, 0.7, 0.9])
par(paint, lift_cup)
rung()
level.set_value(total)
insist(1)
world.simulate(0.1)
print("end", btr.contact(milk, cup))
raise PlanFailure("at last")
"""


def line(text: str) -> int:
    """The number of a line of the plan."""
    return [each.strip() for each in TEXT.splitlines()].index(text) + 1


def recorded(folder: Path) -> Path:
    """The plan's recording."""
    file = folder / "plan.py"
    file.write_text(TEXT)
    return record(file)
