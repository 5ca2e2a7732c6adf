"""Sets the table: the thesis' pick-and-place plan (5.1), on a PR2 in a kitchen.

Milk, bowl and cereal stand on the counter, the spoon lies in a drawer. The robot carries each to the kitchen island;
whatever blocks its way to an object is carried over first, as the bowl that stands before the milk. Run it with
``pycram demo``, or record any variation of it with ``pycram run my_plan.py``.
"""

from __future__ import annotations

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.language import par
from pycram.process_module import ProcessModule

COUNTER = ([0.65, 0.7, 0], [0, 0, 0, 1])
ISLAND = ([-0.3, 1, 0], [0, 0, 1, 0])

# goal and arm for each type of object
TARGETS = {
    "milk": ([-0.8, 1, 0.93], "left"),
    "bowl": ([-0.8, 1.2, 0.9], "right"),
    "cereal": ([-1, 1, 0.94], "right"),
    "spoon": ([-0.8, 1.2, 0.94], "right"),
}


def build_scene() -> Object:
    """Loads floor, robot, kitchen and objects (Listing 5.1); returns the kitchen."""
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    robot = Object("pr2", "robot", "pr2.urdf")
    kitchen = Object("kitchen", "environment", "kitchen.urdf")
    Object("milk", "milk", "milk.stl", [1.45, 1, 1])
    Object("spoon", "spoon", "spoon.stl", [1.4, 0.89, 0.72])
    Object("cereal", "cereal", "breakfast_cereal.stl", [1.3, 0.6, 1])
    Object("bowl", "bowl", "bowl.stl", [1.3, 0.98, 1])  # before the milk
    BulletWorld.robot = robot
    world.simulate(0.5)  # everything comes to rest where it was put
    return kitchen


def perform(**slots: object) -> object:
    """Performs a motion; hyphens in names of slots are written as underscores."""
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def go(place: tuple[list[float], list[float]]) -> None:
    """Drives somewhere with parked arms."""
    position, orientation = place
    with par:
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        perform(type="moving", target=position, orientation=orientation)


def open_drawer(kitchen: Object) -> None:
    """Opens the drawer in which the spoon lies (Listing 5.2)."""
    perform(
        type="accessing",
        drawer_joint="sink_area_left_upper_drawer_main_joint",
        drawer_handle="sink_area_left_upper_drawer_handle",
        part_of=kitchen,
        arm="left",
        distance=0.3,
    )
    perform(type="move-arm-joints", left_arm="park")


def move_object(object_type: str, kitchen: Object) -> None:
    """Carries an object to its place, and whatever blocks it before it (Listings 5.3-5.5)."""
    target, arm = TARGETS[object_type]
    robot = BulletWorld.robot
    gripper = robot.description.arm(arm).tool_frame
    known = BulletWorld.current_bullet_world.get_objects_by_type(object_type)[0]

    print(f"{object_type}: fetching it with the {arm} arm")
    go(COUNTER)
    if object_type == "spoon":
        open_drawer(kitchen)
    perform(type="looking", object=known)
    found = perform(type="detecting", object=object_type)

    blocking = [body for body in btr.blocking(found, robot, gripper) if body.type != "environment"]
    if blocking:
        print(f"{object_type}: {blocking[0].type} is in the way and goes first")
        move_object(blocking[0].type, kitchen)
        go(COUNTER)
    perform(type="pick-up", object=found, arm=arm)
    go(ISLAND)

    if not btr.reachable_pose(target, robot, gripper):
        raise btr.ReasoningError(f"the place for {object_type} is out of reach")
    perform(type="place", object=found, target=target, arm=arm)
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    if not btr.stable(found):
        raise btr.ReasoningError(f"{object_type} doesn't stand safely")
    print(f"{object_type}: placed at", [round(x, 3) for x in found.get_position()])


def set_table(kitchen: Object) -> None:
    """Carries everything to its place."""
    for object_type, (target, _) in TARGETS.items():
        body = BulletWorld.current_bullet_world.get_objects_by_type(object_type)[0]
        away = max(abs(a - b) for a, b in zip(body.get_position(), target, strict=True))
        if away > 0.1:  # the way of another one may have led over it
            move_object(object_type, kitchen)


def main() -> None:
    set_table(build_scene())
    print("the table is set")
    BulletWorld.current_bullet_world.exit()


if __name__ == "__main__":
    main()
