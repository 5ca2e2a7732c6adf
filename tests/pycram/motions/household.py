"""Twelve household objects in four orientations each, that robots carry from one place to another."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.process_module import ProcessModule

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Height in m above what it stands on at which each is put there.
HOUSEHOLD = {
    "spoon": 0.05,
    "milk": 0.1,
    "bowl": 0.04,
    "breakfast_cereal": 0.12,
    "fork": 0.05,
    "knife": 0.05,
    "cup": 0.06,
    "bottle": 0.13,
    "plate": 0.02,
    "pot": 0.08,
    "apple": 0.05,
    "glass": 0.07,
}
CASES = [(kind, degrees) for degrees, kind in itertools.product((0, 30, 45, 60), HOUSEHOLD)]


@dataclass(frozen=True)
class Place:
    """Where a robot works.

    Attributes:
        arm: the arm that it uses.
        top: height of what objects stand on, m.
        start: x and y from where it takes things, m.
        goal: x and y where it puts them, m.
    """

    arm: str
    top: float
    start: tuple[float, float]
    goal: tuple[float, float]


KITCHEN, TABLE = 0.853, 0.72
PLACES = {
    "pr2": Place("left", KITCHEN, (1.36, 0.9), (1.3, 0.75)),
    "tiago_pro": Place("left", KITCHEN, (1.36, 0.9), (1.36, 0.65)),
    "panda": Place("panda", TABLE, (0.5, 0.15), (0.45, -0.25)),
    "ur5": Place("ur5", TABLE, (0.5, 0.15), (0.45, -0.25)),
}


def build(robot: str) -> Iterator[BulletWorld]:
    """Yields a world with a robot at its place."""
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        if PLACES[robot].top == KITCHEN:
            Object("kitchen", "environment", "kitchen.urdf")
            world.robot = Object(robot, "robot", f"{robot}.urdf", [0.65, 0.7, 0])
        else:
            Object("table", "environment", "table.urdf")
            world.robot = Object(robot, "robot", f"{robot}.urdf", [0, 0, TABLE])
        yield world


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def park(world: BulletWorld) -> None:
    perform(type="move-arm-joints", **{f"{arm}_arm": "park" for arm in world.robot.description.arms})


def put(world: BulletWorld, place: Place, kind: str, degrees: int) -> Object:
    """Puts an object down where it is to be taken from."""
    park(world)
    half = math.radians(degrees) / 2
    at = [*place.start, place.top + HOUSEHOLD[kind]]
    body = Object("thing", kind, f"{kind}.stl", at, [0, 0, math.sin(half), math.cos(half)])
    world.simulate(1.0)
    return body


def carry(world: BulletWorld, place: Place, body: Object) -> None:
    """Takes an object and puts it down at the goal."""
    perform(type="pick-up", object=body, arm=place.arm)
    park(world)
    perform(type="place", object=body, target=[*place.goal, place.top + HOUSEHOLD[body.type]], arm=place.arm)
    park(world)
