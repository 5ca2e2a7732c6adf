"""Fails on purpose: the milk stands at the back of the counter, out of reach and behind other objects.

The plan tries each arm from two positions and gives up. Its recording is an example for debugging.
The first command makes the recording, and the second command explains the failure:
``pycram run demos/fails_to_reach.py --log fails.mcap`` and
``pycram-replay why fails.mcap``.
"""

from __future__ import annotations

from pycram import bullet_world_reasoning as btr, perform
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.language import failure_handling, par
from pycram.motion_designators import detecting, looking, move_arm_joints, moving, pick_up

PLACES = ([0.65, 0.9, 0], [0.65, 0.6, 0])


def build_scene() -> Object:
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    robot = Object("pr2", "robot", "pr2.urdf")
    Object("kitchen", "environment", "kitchen.urdf")
    Object("cup", "cup", "cup.stl", [1.32, 0.9, 0.92])
    Object("bowl", "bowl", "bowl.stl", [1.35, 0.7, 0.9])
    milk = Object("milk", "milk", "milk.stl", [1.72, 0.85, 0.96])
    BulletWorld.robot = robot
    robot.set_joint_position("torso_lift_joint", 0.25)
    world.simulate(0.5)
    return milk


def try_to_take(milk: Object, arm: str, place: list[float]) -> None:
    print(f"trying the {arm} arm from", place[:2])
    with par:
        # Both motions run at the same time.
        # Folded arms touch nothing on the way.
        perform(move_arm_joints(arms={"left": "park", "right": "park"}))
        perform(moving(target=place, orientation=[0, 0, 0, 1]))
    perform(looking(object=milk))
    found = perform(detecting(object_type="milk"))
    gripper = BulletWorld.robot.description.arm(arm).tool_frame
    if not btr.reachable(found, BulletWorld.robot, gripper):
        print("  reachable() says no; blocking() says", btr.blocking(found, BulletWorld.robot, gripper))
    perform(pick_up(object=found, arm=arm))


def main() -> None:
    milk = build_scene()
    first, *others = [{"arm": arm, "place": place} for place in PLACES for arm in ("left", "right")]

    def another_way(failure: PlanFailure) -> dict[str, list[float] | str]:
        print(" ", failure)
        return others.pop(0)

    for attempt in failure_handling(len(others), **first).on(PlanFailure, another_way):
        with attempt:
            try_to_take(milk, attempt["arm"], attempt["place"])


if __name__ == "__main__":
    main()
