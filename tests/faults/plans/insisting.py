# holds: at end on(milk, kitchen)
# holds: at end milk.x < 0
"""Tries arms and places in turn until the milk is taken, then carries it to the island."""

from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.language import failure_handling
from pycram.motion_designators import move_arm_joints, moving, pick_up, place

WAYS = [("left", 0.2), ("right", 0.5), ("left", 0.75)]  # arm, and where to stand before the counter

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
Object("kitchen", "environment", "kitchen.urdf")
milk = Object("milk", "milk", "milk.stl", [1.5, 1.1, 0.97])
world.robot = Object("pr2", "robot", "pr2.urdf")
world.settle()


def park():
    perform(move_arm_joints(arms={"left": "park", "right": "park"}))


chosen = {}
for attempt in failure_handling(retries=len(WAYS) - 1):
    with attempt:
        arm, y = WAYS[attempt.number - 1]
        park()
        perform(moving(target=[0.75, y, 0], orientation=[0, 0, 0, 1]))
        perform(pick_up(object=milk, arm=arm))
        chosen["arm"] = arm

if "arm" not in chosen:
    raise PlanFailure("no way led to the milk")
park()
perform(moving(target=[-0.3, 1, 0], orientation=[0, 0, 1, 0]))
perform(place(object=milk, target=[-0.8, 1, 0.93], arm=chosen["arm"]))
world.exit()
