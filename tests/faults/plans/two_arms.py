# holds: at end distance(cup, bowl) > 15 cm
# holds: at end cup.x < -0.5 and bowl.x < -0.5
# holds: eventually holding(left) is cup
"""Takes cup and bowl with both arms at once, and puts both down on the island."""

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
bowl = Object("bowl", "bowl", "bowl.stl", [1.3, 0.5, 0.9])
world.robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
world.settle()

held = Fluent(0, name="held")


def take(thing, arm):
    perform(pick_up(object=thing, arm=arm))
    held.set_value(held.get_value() + 1)


def leave():
    (held == 2).wait_for()
    perform(move_arm_joints(arms={"left": "park", "right": "park"}))
    perform(moving(target=[-0.3, 1, 0], orientation=[0, 0, 1, 0]))


with par as branches:
    branches(take, cup, "left")
    branches(take, bowl, "right")
    branches(leave)

spots = [[-0.8, 0.85, 0.91], [-0.8, 1.15, 0.9]]
for thing, arm, spot in zip((cup, bowl), ("left", "right"), spots, strict=True):
    perform(place(object=thing, target=spot, arm=arm))
    perform(move_arm_joints(arms={arm: "park"}))
world.exit()
