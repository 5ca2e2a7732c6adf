"""Random plans: anything that can happen to worlds happens, in any order; and a witness of what was there."""

from __future__ import annotations

import contextlib
import math
import random
from typing import TYPE_CHECKING

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AttachmentError, ObjectsChanged
from pycram.world.transaction import take_snapshot
from recorder import geometry
from recorder.records import Keyframe, Mutation

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.world.saved_state import SavedState
    from recorder.records import Record

THINGS = ("milk", "bowl", "cup", "apple", "spoon")
DRAWERS = ("sink_area_left_upper_drawer_main_joint", "sink_area_left_middle_drawer_main_joint")


def everything(world: BulletWorld) -> dict[str, object]:
    """All that is true of a world, in numbers that can be compared."""
    facts: dict[str, object] = {}
    for body in world.objects:
        now = take_snapshot(body)
        facts[body.name] = {
            "type": body.type,
            "numbers": [*now.pose[0], *now.pose[1], *now.velocity, *now.positions, *now.velocities],
            "color": body.color,
        }
        for held in body.carried:
            facts[f"{body.name} holds {held.body.name}"] = {
                "links": (held.carrier_link, held.body_link),
                "numbers": [*held.pose[0], *held.pose[1]],
            }
    return facts | {"gravity": world.gravity, "sim_step": world.sim_step, "robot": world.robot and world.robot.name}


class Witness:
    """A sink that writes down what the live worlds have at the very moment of each record."""

    def __init__(self) -> None:
        self.worlds: list[BulletWorld] = []
        self.seen: dict[int, dict[str, dict[str, object]]] = {}

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        if isinstance(record, Mutation | Keyframe):
            self.seen[record.seq] = {world.name: everything(world) for world in self.worlds if not world.closed}

    def attach(self, asset: object) -> None:
        pass

    def flush(self) -> None: ...

    def close(self) -> None:
        pass


class RandomPlan:
    """A plan that is made up as it goes, the same for the same seed."""

    def __init__(self, seed: int, witness: Witness | None = None, changes: int = 20) -> None:
        self.dice = random.Random(seed)
        self.witness = witness
        self.changes = changes
        self.numbers = 0
        self.saved: dict[str, SavedState] = {}

    def run(self) -> None:
        for world in self.go():
            world.exit()

    def go(self) -> list[BulletWorld]:
        worlds = [self.open(f"w{number}") for number in range(self.dice.choice((1, 1, 2)))]
        for _ in range(self.changes):
            self.change(self.dice.choice(worlds))
        return worlds

    def open(self, name: str) -> BulletWorld:
        world = BulletWorld(name=name)
        if self.witness is not None:
            self.witness.worlds.append(world)
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf", world=world)
        if self.dice.random() < 0.4:
            Object("kitchen", "environment", "kitchen.urdf", world=world)
        if self.dice.random() < 0.05:
            world.robot = Object("pr2", "robot", "pr2.urdf", [0.3, 0.6, 0], world=world)
        for _ in range(2):
            self.add(world)
        return world

    def change(self, world: BulletWorld) -> None:
        actions: tuple[Callable[[BulletWorld], None], ...] = (
            self.add,
            self.move,
            self.move,
            self.turn,
            self.drawer,
            self.arm,
            self.attach,
            self.attach,
            self.detach,
            self.simulate,
            self.simulate,
            self.remove,
            self.paint,
            self.reset,
            self.ask,
            self.save_or_restore,
        )
        weights = (3, 3, 3, 2, 4, 3, 4, 4, 2, 3, 3, 1, 1, 0.3, 3, 3)
        self.dice.choices(actions, weights)[0](world)

    def thing(self, world: BulletWorld) -> Object | None:
        free = [body for body in world.objects if not body.fixed]
        return self.dice.choice(free) if free else None

    def place(self) -> list[float]:
        return [self.dice.uniform(1.2, 1.5), self.dice.uniform(0.5, 1.1), self.dice.uniform(0.75, 1.2)]

    def add(self, world: BulletWorld) -> None:
        kind = self.dice.choice(THINGS)
        gone = [name for name in THINGS if not world.get_objects_by_name(name)]  # a name may come again
        name = kind if kind in gone else f"{kind}_{self.numbers}"
        self.numbers += 1
        color = [self.dice.random(), 0, 0, 1] if self.dice.random() < 0.2 else None
        Object(name, kind, f"{kind}.stl", self.place(), self.rotation(), world, color)

    def rotation(self) -> list[float]:
        if self.dice.random() < 0.5:
            return [0, 0, 0, 1]
        return list(geometry.from_rpy(*(self.dice.uniform(-math.pi, math.pi) for _ in range(3))))

    def move(self, world: BulletWorld) -> None:
        body = self.thing(world)
        if body is not None:
            body.set_position(self.place())

    def turn(self, world: BulletWorld) -> None:
        body = self.thing(world)
        if body is not None:
            body.set_position_and_orientation(self.place(), self.rotation())

    def drawer(self, world: BulletWorld) -> None:
        for kitchen in world.get_objects_by_name("kitchen"):
            kitchen.set_joint_position(self.dice.choice(DRAWERS), self.dice.uniform(0, 0.4))

    def arm(self, world: BulletWorld) -> None:
        robot = world.robot
        if robot is not None:
            robot.set_joint_positions(
                {"torso_lift_joint": self.dice.uniform(0, 0.3), "l_shoulder_pan_joint": self.dice.uniform(0, 1)}
            )
            robot.set_position([self.dice.uniform(-0.5, 0.5), self.dice.uniform(0, 1), 0])

    def attach(self, world: BulletWorld) -> None:
        body, carrier = self.thing(world), self.dice.choice(world.objects)
        if self.dice.random() < 0.3 and world.robot is not None:
            carrier = world.robot
        link = self.dice.choice(carrier.links) if self.dice.random() < 0.5 else None
        if body is not None:
            with contextlib.suppress(AttachmentError):  # cycles, and the like
                carrier.attach(body, link)

    def detach(self, world: BulletWorld) -> None:
        body = self.thing(world)
        if body is not None and body.carrier is not None:
            body.detach(body.carrier)

    def simulate(self, world: BulletWorld) -> None:
        world.simulate(self.dice.choice((0.01, 0.05, 0.15)))

    def remove(self, world: BulletWorld) -> None:
        body = self.thing(world)
        if body is not None:
            body.remove()

    def paint(self, world: BulletWorld) -> None:
        body = self.thing(world)
        if body is not None:
            body.set_color([self.dice.random(), self.dice.random(), 0, 1])

    def reset(self, world: BulletWorld) -> None:
        world.reset()

    def save_or_restore(self, world: BulletWorld) -> None:
        if world.name not in self.saved or self.dice.random() < 0.3:
            self.saved[world.name] = world.save()
            return
        with contextlib.suppress(ObjectsChanged):
            world.restore(self.saved.pop(world.name))

    def ask(self, world: BulletWorld) -> None:
        body, other = self.thing(world), self.dice.choice(world.objects)
        if body is not None and body is not other:
            btr.contact(body, other)
            btr.supporting(other, body)
            body.get_AABB()
