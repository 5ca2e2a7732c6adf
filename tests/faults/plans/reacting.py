# holds: at end on(cup, kitchen)
# holds: at end cup.x < 0
# holds: eventually robot.x < 0
"""Carries a cup to the island in simulated time, and counts how often it was lifted and put down."""

from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.fluent import Fluent
from pycram.language import par
from pycram.motion_designators import move_arm_joints, moving, pick_up, place

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
Object("kitchen", "environment", "kitchen.urdf")
cup = Object("cup", "cup", "cup.stl", [1.3, 0.9, 0.92])
world.robot = robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
world.settle()

stage = Fluent("begin", name="stage")
counts = {"lifted": 0}


def count():
    counts["lifted"] += 1


def work():
    perform(move_arm_joints(arms={"left": "park", "right": "park"}))
    perform(pick_up(object=cup, arm="left"))
    stage.set_value("lifted")
    perform(move_arm_joints(arms={"left": "park", "right": "park"}))
    perform(moving(target=[-0.3, 1, 0], orientation=[0, 0, 1, 0]))
    perform(place(object=cup, target=[-0.8, 1, 0.91], arm="left"))
    stage.set_value("done")


def watch():
    (stage == "lifted").wait_for()
    count()
    (stage == "done").wait_for()


with par as branches:
    branches(work)
    branches(watch)
assert counts["lifted"] == 1
world.exit()
