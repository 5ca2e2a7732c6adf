"""Places that are hard to put something on: edges, clutter, slopes, bowls, and gaps beside a neighbour."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.process_module import ProcessModule
from recorder import geometry

if TYPE_CHECKING:
    from pathlib import Path

TOP: Final = 0.75  # m: height of the table
EDGE: Final = 0.45  # m: where it begins, in front of the robot
TOOL: Final = "l_gripper_tool_frame"
HEIGHTS: Final = {  # m: of the base frame above what an upright object stands on
    "milk": 0.1,
    "breakfast_cereal": 0.115,
    "cup": 0.049,
    "bottle": 0.128,
    "glass": 0.063,
    "bowl": 0.0365,
    "apple": 0.0428,
    "spoon": 0.0126,
    "knife": 0.0075,
    "fork": 0.0108,
}
TALL: Final = ("milk", "breakfast_cereal", "cup", "bottle", "glass")
_HALF: Final = {  # m: half of their width
    "milk": 0.036,
    "breakfast_cereal": 0.05,
    "cup": 0.046,
    "bottle": 0.038,
    "glass": 0.038,
    "bowl": 0.073,
    "spoon": 0.026,
    "knife": 0.013,
    "fork": 0.015,
}
NARROW: Final = ("spoon", "knife", "fork", "bowl", "glass")  # where they are held: fingers open far
KINDS: Final = ("edge", "clutter", "slope", "bowl")
_BOX: Final = (
    '<robot name="{name}"><link name="{name}"><visual><geometry><box size="{size}"/></geometry></visual>'
    '<collision><geometry><box size="{size}"/></geometry></collision></link></robot>'
)


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def box(folder: Path, name: str, size: tuple[float, float, float]) -> str:
    file = folder / f"{name}.urdf"
    file.write_text(_BOX.format(name=name, size=" ".join(map(str, size))))
    return str(file)


def at_table(folder: Path) -> BulletWorld:
    """A PR2 before a table, alone."""
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    table = box(folder, "table", (0.8, 1.6, 0.04))
    Object("table", "environment", table, [EDGE + 0.4, 0, TOP - 0.02])
    world.robot = Object("pr2", "robot", "pr2.urdf")
    return world


@dataclass
class Placing:
    """An object in the hand, and where it is to be put.

    Attributes:
        body: in the left gripper.
        target: where it would stand if nothing but the table, or the slope, were there.
        others: what else is in the scene.
    """

    body: Object
    target: list[float]
    others: list[Object] = field(default_factory=list)

    def off(self) -> float:
        """How far it is from its target on the ground, m."""
        x, y, _ = self.body.get_position()
        return math.hypot(x - self.target[0], y - self.target[1])

    def tilt(self) -> float:
        """By how much it leans, degrees."""
        up = geometry.rotate(self.body.get_orientation(), (0.0, 0.0, 1.0))[2]
        return math.degrees(math.acos(max(-1.0, min(1.0, up))))

    def remove(self) -> None:
        for body in (self.body, *self.others):
            body.remove()


def fall(world: BulletWorld, body: Object) -> tuple[float, float]:
    """How far an object moves within the next 2 s, m, and how far it turns, degrees; the hand leaves it alone."""
    robot = world.robot
    robot.set_joint_positions(robot.description.arm("left").posture("park"))
    at, turn = body.get_position_and_orientation()
    world.simulate(2.0)
    later, turned = body.get_position_and_orientation()
    return math.dist(at, later), math.degrees(geometry.angle(turn, turned))


def hold(world: BulletWorld, kind: str, yaw: float) -> Object:
    """An object that the left gripper has taken from the table's end."""
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    body = Object("thing", kind, f"{kind}.stl", [0.62, 0.55, TOP + HEIGHTS[kind] + 0.001], geometry.from_rpy(0, 0, yaw))
    world.simulate(0.4)
    perform(type="pick-up", object=body, arm="left")
    return body


def random_placing(world: BulletWorld, folder: Path, seed: int) -> Placing:
    """A hard place: the kind goes round with the seed."""
    rng = np.random.default_rng(seed)
    where = KINDS[seed % len(KINDS)]
    kind = str(rng.choice(("apple", "glass", "cup", "spoon") if where == "bowl" else TALL))
    body = hold(world, kind, float(rng.uniform(-1.5, 1.5)))
    height = TOP + HEIGHTS[kind]
    if where == "edge":
        return Placing(body, [EDGE + float(rng.uniform(-0.03, 0.05)), float(rng.uniform(-0.05, 0.35)), height])
    x, y = float(rng.uniform(0.55, 0.7)), float(rng.uniform(0.0, 0.3))
    if where == "slope":
        tilt, turn = math.radians(rng.uniform(4, 35)), float(rng.uniform(-math.pi, math.pi))
        slope = box(folder, "slope", (0.24, 0.24, 0.02))
        rise = TOP + 0.12 * math.sin(tilt) + 0.012
        lying = geometry.product(geometry.from_rpy(0, 0, turn), geometry.from_rpy(tilt, 0, 0))
        ramp = Object("slope", "environment", slope, [x, y, rise], lying)
        return Placing(body, [x, y, rise + 0.01 / math.cos(tilt) + HEIGHTS[kind]], [ramp])
    if where == "bowl":
        vessel = str(rng.choice(("bowl", "pot")))
        hollow = Object("vessel", vessel, f"{vessel}.stl", [x, y, TOP + (0.064 if vessel == "pot" else 0.037)])
        off = rng.uniform(-0.03, 0.03, 2)
        return Placing(body, [x + float(off[0]), y + float(off[1]), height + 0.03], [hollow])
    others = []
    for number in range(int(rng.integers(3, 7))):
        other = str(rng.choice((*TALL, "bowl", "apple")))
        at = [x + float(rng.uniform(-0.18, 0.18)), y + float(rng.uniform(-0.18, 0.18)), TOP + HEIGHTS[other] + 0.002]
        clutter = Object(f"clutter_{number}", other, f"{other}.stl", at, geometry.from_rpy(0, 0, rng.uniform(-3, 3)))
        if any(world.engine.closest_points(clutter.handle, known.handle, 0.002) for known in (*others, body)):
            clutter.remove()
        else:
            others.append(clutter)
    world.simulate(0.3)
    return Placing(body, [x, y, height], others)


def beside_a_neighbour(world: BulletWorld, seed: int) -> Placing:
    """A place on the table with something that stands 3 to 40 mm beside it, on any side."""
    rng = np.random.default_rng(seed)
    kind, other = str(rng.choice(NARROW)), str(rng.choice(TALL))
    body = hold(world, kind, float(rng.uniform(-1.5, 1.5)))
    x, y = float(rng.uniform(0.55, 0.68)), float(rng.uniform(0.0, 0.3))
    way, gap = float(rng.uniform(-math.pi, math.pi)), float(rng.uniform(0.003, 0.04))
    turn = geometry.from_rpy(0, 0, float(rng.uniform(-3, 3)))
    away = _HALF[kind] + _HALF[other] + gap
    at = [x + away * math.cos(way), y + away * math.sin(way), TOP + HEIGHTS[other] + 0.001]
    neighbour = Object("neighbour", other, f"{other}.stl", at, turn)
    world.simulate(0.3)
    return Placing(body, [x, y, TOP + HEIGHTS[kind]], [neighbour])


def finger_depth(world: BulletWorld, body: Object) -> float:
    """How deep the left fingers are in an object, m; negative if they don't touch it."""
    fingers = world.robot.description.arm("left").gripper.fingers
    robot = world.robot.handle
    touches = [t.distance for f in fingers for t in world.engine.link_closest_points(robot, f, body.handle, 0.05)]
    return -min(touches, default=0.05)
