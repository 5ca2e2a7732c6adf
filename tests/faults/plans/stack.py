# holds: at end on(cup, plate)
# holds: at end upright(cup)
# holds: at end distance(plate, [-0.8, 1.1, 0.85]) < 10 cm
"""Carries a plate to the kitchen island, and puts a cup onto it."""

from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import move_arm_joints, moving, pick_up, place

COUNTER = [0.65, 0.7, 0]
ISLAND = [-0.3, 1, 0]
FACING_COUNTER, FACING_ISLAND = [0, 0, 0, 1], [0, 0, 1, 0]
TARGET = [-0.8, 1.1, 0.87]
ARM = "right"

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
kitchen = Object("kitchen", "environment", "kitchen.urdf")
plate = Object("plate", "plate", "plate.stl", [1.32, 0.6, 0.87])
cup = Object("cup", "cup", "cup.stl", [1.3, 0.95, 0.92])
world.robot = Object("pr2", "robot", "pr2.urdf", COUNTER)
world.settle()


def park():
    perform(move_arm_joints(arms={"left": "park", "right": "park"}))


def fetch(thing, arm):
    park()
    perform(moving(target=COUNTER, orientation=FACING_COUNTER))
    perform(pick_up(object=thing, arm=arm))
    park()


def deliver(thing, target, arm):
    perform(moving(target=ISLAND, orientation=FACING_ISLAND))
    perform(place(object=thing, target=target, arm=arm))
    park()


fetch(plate, ARM)
deliver(plate, TARGET, ARM)
x, y, _ = plate.get_position()
top = plate.get_AABB()[1][2]
height = cup.get_AABB()[1][2] - cup.get_AABB()[0][2]
fetch(cup, "left")
deliver(cup, [x, y, top + height / 2 + 0.005], "left")
world.exit()
