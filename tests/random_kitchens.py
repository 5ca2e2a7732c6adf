"""Random kitchens: where things stand, what stands open, and where the robot is, drawn from a seed.

A kitchen is drawn as numbers first (:func:`draw`), then built (:func:`build`): nothing overlaps, everything has come to
rest where it was put, and the robot touches nothing. The same seed gives the same kitchen in any process.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import trimesh

from pycram.bullet_world import BulletWorld, Object
from pycram.models.files import resources
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from recorder.geometry import Quaternion

    #: Corners of a rectangle, m.
    Outline = np.ndarray

#: What is carried, and what else stands about; the first can be held by all grippers.
KINDS: Final = (
    "milk",
    "breakfast_cereal",
    "bowl",
    "cup",
    "bottle",
    "glass",
    "apple",
    "spoon",
    "fork",
    "knife",
    "plate",
    "pot",
)
_FLAT: Final = ("spoon", "fork", "knife")
_GAP: Final = 0.012  # m at least between two things
_DROP: Final = 0.001  # m above what it stands on at which each is loaded
_SHIFT: Final = 0.02  # m that it may move until it rests
_LEAN: Final = math.radians(5)
_CLEAR: Final = 0.03  # m between the robot and what is about it
_PLACES: Final = 60  # to stand at, of which the first free one is taken


@dataclass(frozen=True)
class Spot:
    """A rectangle that things stand on, in the frame of its link.

    Attributes:
        link: of the furniture.
        x: from, to; m.
        y: from, to; m.
        z: height of the rectangle, m.
        clearance: free height above it, m.
        joint: what opens to get at it; "" if it is free.
        open: how far that opens here, m or rad.
    """

    link: str
    x: tuple[float, float]
    y: tuple[float, float]
    z: float
    clearance: float = math.inf
    joint: str = ""
    open: float = 0.0


def _drawer(name: str, width: float, height: float, clearance: float, back: float) -> Spot:
    half, opened = width / 2 - 0.047, 0.4
    bottom = 0.018 - height / 2
    return Spot(f"{name}_main", (back + 0.02, 0.25), (-half, half), bottom, clearance, f"{name}_main_joint", opened)


def _shelf(z: float) -> Spot:
    return Spot("iai_fridge_main", (-0.19, 0.18), (-0.25, 0.25), z, 0.2, "iai_fridge_door_joint", 1.4)


def _board(z: float) -> Spot:
    name = "oven_area_area_left_drawer_main"
    return Spot(name, (-0.22, 0.24), (-0.11, 0.11), z + 0.0125, 0.27, f"{name}_joint", 0.45)


SPOTS: Final[Mapping[str, Spot]] = {
    "counter": Spot("sink_area_surface", (-0.26, 0.25), (-0.99, 0.03), 0.01),  # but for sink and draining board
    "table": Spot("table_area_main", (-0.77, 0.77), (-0.37, 0.37), 0.725),
    "island": Spot("kitchen_island_surface", (-0.37, 0.37), (-1.19, 0.46), 0.01),  # but for the hob
    "upper sink drawer": _drawer("sink_area_left_upper_drawer", 0.8, 0.138, 0.11, -0.272),
    "middle sink drawer": _drawer("sink_area_left_middle_drawer", 0.8, 0.287, 0.26, -0.272),
    "upper oven drawer": _drawer("oven_area_area_middle_upper_drawer", 0.6, 0.135, 0.11, -0.27),
    "left island drawer": _drawer("kitchen_island_left_upper_drawer", 0.6, 0.287, 0.26, -0.275),
    "middle island drawer": _drawer("kitchen_island_middle_upper_drawer", 1.0, 0.287, 0.26, -0.275),
    "low shelf": _shelf(0.028),
    "middle shelf": _shelf(0.258),
    "lower board": _board(-0.33),
    "board": _board(0.0),
}
ISLAND: Final = ("kitchen_island_surface", "kitchen_island_stove")
_WHERE: Final = {  # how often the thing is there, of 100
    "counter": 40,
    "table": 14,
    "upper sink drawer": 9,
    "middle sink drawer": 6,
    "upper oven drawer": 4,
    "left island drawer": 3,
    "middle island drawer": 4,
    "low shelf": 6,
    "middle shelf": 6,
    "lower board": 2,
    "board": 6,
}
#: What else stands open, and how far at most.
_AJAR: Final = {
    "sink_area_left_upper_drawer_main_joint": 0.4,
    "sink_area_left_middle_drawer_main_joint": 0.4,
    "sink_area_trash_drawer_main_joint": 0.4,
    "sink_area_dish_washer_door_joint": 1.57,
    "iai_fridge_door_joint": 1.57,
    "fridge_area_lower_drawer_main_joint": 0.3,
    "oven_area_oven_door_joint": 1.57,
    "oven_area_area_left_drawer_main_joint": 0.45,
    "kitchen_island_left_upper_drawer_main_joint": 0.4,
    "kitchen_island_middle_upper_drawer_main_joint": 0.4,
    "kitchen_island_right_upper_drawer_main_joint": 0.4,
}


@dataclass(frozen=True)
class Standing:
    """A thing and where it stands.

    Attributes:
        kind: of thing.
        spot: name of what it stands on.
        x: in the frame of the spot's link, m.
        y: as x.
        yaw: as x, rad.
    """

    kind: str
    spot: str
    x: float
    y: float
    yaw: float


@dataclass(frozen=True)
class Drawing:
    """A kitchen before it is built.

    Attributes:
        seed: it is drawn from.
        thing: what is to be carried to the island.
        others: what else stands about.
        joints: those that stand open, m or rad.
        starts: x, y and yaw of places where the robot may be; it is at the first free one.
    """

    seed: int
    thing: Standing
    others: tuple[Standing, ...]
    joints: Mapping[str, float]
    starts: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Scene:
    """A kitchen that is built.

    Attributes:
        drawing: that it is built after.
        world: it is in.
        kitchen: the furniture.
        thing: what is to be carried to the island.
        others: what else stands about.
    """

    drawing: Drawing
    world: BulletWorld
    kitchen: Object
    thing: Object
    others: tuple[Object, ...]

    @property
    def robot(self) -> Object:
        return self.world.robot

    @property
    def spot(self) -> Spot:
        """What the thing stands on."""
        return SPOTS[self.drawing.thing.spot]


@functools.cache
def size(kind: str) -> tuple[float, float, float]:
    """The sides of the box about a thing, m; its frame is in the middle."""
    lower, upper = trimesh.load(resources() / f"{kind}.stl").bounds
    x, y, z = (upper - lower).tolist()
    return x, y, z


def draw(seed: int) -> Drawing:
    """Draw a kitchen."""
    rng = np.random.default_rng([19, seed])
    names = list(_WHERE)
    spot = names[rng.choice(len(names), p=np.array([_WHERE[name] for name in names]) / 100)]
    thing = None
    while thing is None:
        thing = _stand(rng, spot, [])
    taken = [thing]
    near = int(rng.integers(0, 4)) if rng.random() < 0.6 else 0
    far = int(rng.integers(2, 9))
    for number in range(near + far):
        beside = taken[0] if number < near else None
        where = spot if beside else _elsewhere(rng)
        other = _stand(rng, where, taken, beside)
        if other is not None:
            taken.append(other)
    joints = {}
    for joint, most in _AJAR.items():
        if rng.random() < 0.15:
            joints[joint] = round(float(rng.uniform(0.3, 1.0)) * most, 3)
    opens = SPOTS[spot].joint
    if opens and rng.random() < 0.4:
        joints[opens] = SPOTS[spot].open
    elif opens:
        joints.pop(opens, None)
    starts = tuple(
        (
            round(float(rng.uniform(-0.3, 0.9)), 3),
            round(float(rng.uniform(-0.8, 2.3)), 3),
            round(float(rng.uniform(-math.pi, math.pi)), 3),
        )
        for _ in range(_PLACES)
    )
    return Drawing(seed, thing, tuple(taken[1:]), joints, starts)


def _elsewhere(rng: np.random.Generator) -> str:
    """Where clutter stands: mostly on top of something."""
    if rng.random() < 0.75:
        return str(rng.choice(["counter", "counter", "island", "island", "table"]))
    return str(rng.choice(list(SPOTS)))


def _stand(
    rng: np.random.Generator, name: str, taken: Sequence[Standing], beside: Standing | None = None
) -> Standing | None:
    """Put some thing that fits down where nothing stands yet; None if there was no room in a few tries."""
    spot = SPOTS[name]
    free = [kind for kind in KINDS if not taken or kind != taken[0].kind]  # of its kind the thing is the only one
    kinds = [kind for kind in free if size(kind)[2] < spot.clearance - 0.02]
    if spot.clearance < 0.15 and rng.random() < 0.7:
        kinds = [kind for kind in _FLAT if kind in free]  # as one keeps them
    kind = str(rng.choice(kinds))
    others = [_outline(other) for other in taken if other.spot == name]
    for _ in range(20):
        if beside is None:
            x, y = rng.uniform(*spot.x), rng.uniform(*spot.y)
        else:
            way, away = rng.uniform(-math.pi, math.pi), rng.uniform(0.06, 0.28)
            x, y = beside.x + away * math.cos(way), beside.y + away * math.sin(way)
        found = Standing(kind, name, round(float(x), 4), round(float(y), 4), round(float(rng.uniform(-3.14, 3.14)), 4))
        outline = _outline(found)
        low, high = outline.min(axis=0), outline.max(axis=0)
        inside = spot.x[0] <= low[0] and high[0] <= spot.x[1] and spot.y[0] <= low[1] and high[1] <= spot.y[1]
        if inside and not any(_meet(outline, other) for other in others):
            return found
    return None


def _outline(standing: Standing) -> Outline:
    width, depth, _ = size(standing.kind)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [(width + _GAP) / 2, (depth + _GAP) / 2]
    cos, sin = math.cos(standing.yaw), math.sin(standing.yaw)
    outline: Outline = corners @ np.array([[cos, sin], [-sin, cos]]) + [standing.x, standing.y]
    return outline


def _meet(one: Outline, other: Outline) -> bool:
    """Whether two rectangles overlap: no side of either lies between them."""
    for outline in (one, other):
        for side in (outline[1] - outline[0], outline[2] - outline[1]):
            a, b = one @ side, other @ side
            if a.max() < b.min() or b.max() < a.min():
                return False
    return True


def build(drawing: Drawing, robot: str = "pr2") -> Scene:
    """Build a kitchen in a new world, which is the caller's to end.

    What doesn't come to rest where it was put is left out: a knife that stands against a rail.

    Raises:
        RuntimeError: the thing itself doesn't, or there is no place for the robot: a drawing that won't do.
    """
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    kitchen = Object("kitchen", "environment", "kitchen.urdf")
    if drawing.joints:
        kitchen.set_joint_positions(drawing.joints)
    thing, *others = [
        _load(kitchen, standing, "thing" if number == 0 else f"{standing.kind}_{number}")
        for number, standing in enumerate((drawing.thing, *drawing.others))
    ]
    world.settle(timeout=5)
    for body, standing in list(zip(others, drawing.others, strict=True)):
        if not rests(kitchen, body, standing):
            body.remove()
            others.remove(body)
    world.settle(timeout=5)
    if not rests(kitchen, thing, drawing.thing):
        world.exit()
        raise RuntimeError(f"kitchen {drawing.seed}: {drawing.thing} doesn't stay there")
    world.robot = Object(robot, "robot", f"{robot}.urdf", [0.3, 0.5, 0])
    for arm in world.robot.description.arms.values():
        world.robot.set_joint_positions(arm.posture("park"))
    if not any(_stands_at(world, start) for start in drawing.starts):
        world.exit()
        raise RuntimeError(f"kitchen {drawing.seed}: there is no place for {robot}")
    return Scene(drawing, world, kitchen, thing, tuple(others))


def _load(kitchen: Object, standing: Standing, name: str) -> Object:
    position, orientation = _pose(kitchen, standing)
    return Object(name, standing.kind, f"{standing.kind}.stl", position, orientation)


def _pose(kitchen: Object, standing: Standing) -> tuple[list[float], Quaternion]:
    spot = SPOTS[standing.spot]
    at, turn = kitchen.get_link_position_and_orientation(spot.link)
    local = [standing.x, standing.y, spot.z + size(standing.kind)[2] / 2 + _DROP]
    x, y, z = geometry.rotate(turn, local)
    return [at[0] + x, at[1] + y, at[2] + z], geometry.product(turn, geometry.from_rpy(0, 0, standing.yaw))


def rests(kitchen: Object, body: Object, standing: Standing) -> bool:
    """Whether a thing stands where it is drawn."""
    position, orientation = _pose(kitchen, standing)
    return math.dist(position, body.get_position()) < _SHIFT and (
        standing.kind == "apple" or geometry.lean(body.get_orientation(), orientation) < _LEAN
    )


def _stands_at(world: BulletWorld, start: tuple[float, float, float]) -> bool:
    """Put the robot somewhere; whether all but the floor is away from it."""
    x, y, yaw = start
    robot = world.robot
    robot.set_position_and_orientation([x, y, 0], geometry.from_rpy(0, 0, yaw))
    return not any(touching(world, [robot], [body for body in world.objects if body.name not in {robot.name, "floor"}]))


def touching(
    world: BulletWorld, bodies: Iterable[Object], others: Sequence[Object], within: float = _CLEAR
) -> Iterable[tuple[str, str, float]]:
    """Which of some bodies are nearer to which others than a distance; and how near, m."""
    for body in bodies:
        for other in others:
            points = world.engine.closest_points(body.handle, other.handle, within) if other is not body else ()
            if points:
                yield body.name, other.name, min(point.distance for point in points)


def stands_on_island(scene: Scene) -> str:
    """Why the thing doesn't stand stably on the island, "" if it does; looked at from outside.

    It touches the island's top and nothing of the robot, it is upright, and in one second more it stays where it is.
    """
    thing, engine = scene.thing, scene.world.engine
    if thing.carrier is not None:
        return f"{thing.carrier.name} holds it"
    scene.world.settle(timeout=5)  # a knife may tremble in a drawer for longer: what counts is whether the thing moves
    before = thing.get_position()
    if not any(point.link_b in ISLAND for point in engine.closest_points(thing.handle, scene.kitchen.handle, 0.002)):
        return f"it is at {[round(value, 3) for value in before]}, not on the island"
    if engine.closest_points(thing.handle, scene.robot.handle, 0.001):
        return "the robot touches it"
    leaning = 0.0 if thing.type == "apple" else geometry.lean(thing.get_orientation(), (0.0, 0.0, 0.0, 1.0))
    scene.world.simulate(1.0)
    moved = math.dist(before, thing.get_position())
    if leaning > 2 * _LEAN or moved > _SHIFT / 2:
        return f"it leans by {math.degrees(leaning):.0f} degrees, and moves by {moved:.3f} m in a second"
    return ""
