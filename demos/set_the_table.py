"""Sets the table: the thesis' pick-and-place plan (5.1), on a PR2 in a kitchen, or on another robot.

Milk, bowl and cereal stand on the counter, the spoon lies in a drawer. The robot carries each object to the island. If
an object blocks the way, such as the bowl before the milk, the robot carries this obstacle to the island first. Arms
that are bolted down carry the same objects from one side of a table to the other. Run the plan with ``pycram demo``,
on another robot with ``pycram demo --robot panda``, or record your variation with ``pycram run my_plan.py``.
"""

from __future__ import annotations

import argparse
from typing import TypeAlias

from pycram import bullet_world_reasoning as btr, perform
from pycram.bullet_world import BulletWorld, Object
from pycram.language import par
from pycram.motion_designators import (
    accessing,
    detecting,
    looking,
    move_arm_joints,
    moving,
    pick_up,
    place,
    world_state_detecting,
)

ROBOTS = ("pr2", "tiago_pro", "panda", "ur5")
BOLTED_DOWN = ("panda", "ur5")

Pose: TypeAlias = tuple[list[float], list[float]]  # position in m, and orientation as a quaternion

COUNTER: Pose = ([0.65, 0.7, 0], [0, 0, 0, 1])
COUNTERS: dict[str, Pose] = {"tiago_pro": ([0.5, 0.9, 0], [0, 0, 0, 1])}  # where else a robot stands there
ISLAND: Pose = ([-0.3, 1, 0], [0, 0, 1, 0])

# goal and arm for each type of object: in the kitchen, and on a table, where a robot has one arm
TARGETS = {
    "milk": ([-0.8, 1, 0.93], "left"),
    "bowl": ([-0.8, 1.2, 0.9], "right"),
    "cereal": ([-1, 1, 0.94], "right"),
    "spoon": ([-0.8, 1.2, 0.94], "right"),
}
TARGETS_ON_TABLE = {
    "milk": ([0.45, 0.4, 0.82], ""),
    "bowl": ([0.5, 0.15, 0.75], ""),
    "cereal": ([0.3, 0.45, 0.84], ""),
    "spoon": ([0.5, 0.15, 0.78], ""),
}


def build_scene(robot: str = "pr2") -> Object:
    """Loads floor, robot, furniture and objects (Listing 5.1); returns the furniture."""
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    if robot in BOLTED_DOWN:
        return build_table(world, robot)
    body = Object(robot, "robot", f"{robot}.urdf")
    kitchen = Object("kitchen", "environment", "kitchen.urdf")
    Object("milk", "milk", "milk.stl", [1.45, 1, 1])
    Object("spoon", "spoon", "spoon.stl", [1.4, 0.89, 0.72])
    Object("cereal", "cereal", "breakfast_cereal.stl", [1.3, 0.6, 1])
    Object("bowl", "bowl", "bowl.stl", [1.3, 0.98, 1])  # before the milk
    BulletWorld.robot = body
    world.simulate(0.5)  # the objects come to rest
    return kitchen


def build_table(world: BulletWorld, robot: str) -> Object:
    """Loads a table, a robot that is bolted to the table, and the objects; returns the table."""
    table = Object("table", "environment", "table.urdf")
    BulletWorld.robot = body = Object(robot, "robot", f"{robot}.urdf", [0, 0, 0.72])
    for arm in body.description.arms.values():  # the unfolded arm would be in the way of the objects
        body.set_joint_positions(arm.posture("park"))
    Object("milk", "milk", "milk.stl", [0.62, -0.25, 0.83])
    Object("spoon", "spoon", "spoon.stl", [0.3, -0.45, 0.74])
    Object("cereal", "cereal", "breakfast_cereal.stl", [0.45, -0.5, 0.85])
    Object("bowl", "bowl", "bowl.stl", [0.46, -0.25, 0.76])  # before the milk
    world.simulate(0.5)
    return table


def park() -> None:
    """Folds all arms."""
    perform(move_arm_joints(arms=dict.fromkeys(BulletWorld.robot.description.arms, "park")))


def go(pose: Pose) -> None:
    """Drives to a pose with parked arms, if the robot can drive."""
    position, orientation = pose
    with par:
        park()
        if BulletWorld.robot.description.drives:
            perform(moving(target=position, orientation=orientation))


def find(known: Object) -> Object:
    """Looks at an object and detects it, if the robot has a camera."""
    if BulletWorld.robot.description.camera is None:
        return perform(world_state_detecting(object_type=known.type))
    perform(looking(object=known))
    return perform(detecting(object_type=known.type))


def open_drawer(kitchen: Object) -> None:
    """Opens the drawer in which the spoon lies (Listing 5.2)."""
    perform(
        accessing(
            drawer_joint="sink_area_left_upper_drawer_main_joint",
            drawer_handle="sink_area_left_upper_drawer_handle",
            part_of=kitchen,
            arm="left",
            distance=0.3,
        )
    )
    perform(move_arm_joints(arms={"left": "park"}))


def targets() -> dict[str, tuple[list[float], str]]:
    """Returns goal and arm for each type of object, for this robot."""
    description = BulletWorld.robot.description
    if description.drives:
        return TARGETS
    (arm,) = description.arms
    return {kind: (goal, arm) for kind, (goal, _) in TARGETS_ON_TABLE.items()}


def move_object(object_type: str, furniture: Object, waiting: tuple[str, ...] = ()) -> None:
    """Carries an object to its place, and obstacles before it (Listings 5.3-5.5), while objects are ``waiting``."""
    target, arm = targets()[object_type]
    robot = BulletWorld.robot
    gripper = robot.description.arm(arm).tool_frame
    counter = COUNTERS.get(robot.name, COUNTER)
    known = BulletWorld.current_bullet_world.get_objects_by_type(object_type)[0]

    print(f"{object_type}: fetching it with the {arm} arm")
    go(counter)
    if object_type == "spoon" and furniture.name == "kitchen":
        open_drawer(furniture)
    found = find(known)

    blocking = [body for body in btr.blocking(found, robot, gripper) if body.type != "environment"]
    if blocking:
        waiting = (*waiting, object_type)
        if blocking[0].type in waiting:
            circle = " and ".join(waiting[waiting.index(blocking[0].type) :])
            raise btr.ReasoningError(f"{circle} block each other, so none can be cleared away first")
        print(f"{object_type}: {blocking[0].type} is in the way and goes first")
        move_object(blocking[0].type, furniture, waiting)
        go(counter)
    perform(pick_up(object=found, arm=arm))
    go(ISLAND)

    if not btr.reachable_pose(target, robot, gripper):
        raise btr.ReasoningError(f"the place for {object_type} is out of reach")
    perform(place(object=found, target=target, arm=arm))
    park()
    if not btr.stable(found):
        raise btr.ReasoningError(f"{object_type} doesn't stand safely")
    print(f"{object_type}: placed at", [round(x, 3) for x in found.get_position()])


def set_table(furniture: Object) -> None:
    """Carries all objects to their places."""
    for object_type, (target, _) in targets().items():
        body = BulletWorld.current_bullet_world.get_objects_by_type(object_type)[0]
        away = max(abs(a - b) for a, b in zip(body.get_position(), target, strict=True))
        if away > 0.1:  # the robot may have carried it away as an obstacle
            move_object(object_type, furniture)


def main(robot: str = "pr2") -> None:
    set_table(build_scene(robot))
    print("the table is set")
    BulletWorld.current_bullet_world.exit()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Sets the table.")
    parser.add_argument("--robot", choices=ROBOTS, default="pr2")
    main(parser.parse_args().robot)
