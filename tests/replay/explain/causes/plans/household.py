"""What the plans share: the thesis' kitchen with a PR2 before the counter, a robot bolted to a table, and short words."""

from __future__ import annotations

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.language import par
from pycram.process_module import ProcessModule

COUNTER = [0.65, 0.7, 0]
ISLAND = [-0.3, 1, 0]
FACING_COUNTER, FACING_ISLAND = [0, 0, 0, 1], [0, 0, 1, 0]
MESHES = {"cereal": "breakfast_cereal"}


def perform(**slots: object) -> object:
    """Performs a motion; hyphens in names of slots are written as underscores."""
    return ProcessModule.perform(MotionDesignator([(name.replace("_", "-"), value) for name, value in slots.items()]))


def put(name: str, position: list[float], orientation: list[float] | None = None) -> Object:
    """Loads a household object."""
    return Object(name, name, f"{MESHES.get(name, name)}.stl", position, orientation or [0, 0, 0, 1])


def kitchen(**things: list[float]) -> BulletWorld:
    """Opens a world with the kitchen, a PR2 with parked arms before the counter, and things by name."""
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    Object("kitchen", "environment", "kitchen.urdf")
    world.robot = Object("pr2", "robot", "pr2.urdf")
    park()
    world.robot.set_position(COUNTER)
    for name, position in things.items():
        put(name, position)
    world.simulate(0.5)
    return world


def table(robot: str, **things: list[float]) -> BulletWorld:
    """Opens a world with a robot that is bolted to a table, and things by name."""
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    Object("table", "environment", "table.urdf")
    world.robot = Object(robot, "robot", f"{robot}.urdf", [0, 0, 0.72])
    for arm in world.robot.description.arms.values():
        world.robot.set_joint_positions(arm.posture("park"))
    for name, position in things.items():
        put(name, position)
    world.simulate(0.5)
    return world


def park() -> None:
    """Folds both arms of the PR2."""
    perform(type="move-arm-joints", left_arm="park", right_arm="park")


def drive(target: list[float], orientation: list[float]) -> None:
    """Drives somewhere with folded arms."""
    with par:
        park()
        perform(type="moving", target=target, orientation=orientation)
