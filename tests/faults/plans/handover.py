# holds: eventually holding(left) is cereal
# holds: eventually holding(right) is cereal
# holds: at end on(cereal, kitchen)
# holds: at end cereal.x < -0.5
"""Passes the cereal from the right hand to the left one, and puts it down with that."""

from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import move_arm_joints, move_tcp, moving, pick_up, place

GIVING, TAKING = "right", "left"

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
Object("kitchen", "environment", "kitchen.urdf")
cereal = Object("cereal", "cereal", "breakfast_cereal.stl", [1.3, 0.6, 0.98])
world.robot = robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
world.settle()

perform(move_arm_joints(arms={"left": "park", "right": "park"}))
perform(pick_up(object=cereal, arm=GIVING))
perform(moving(target=[0.3, 0.7, 0]))
base = robot.get_position()
meeting = [base[0] + 0.6, base[1], base[2] + 1.0]
perform(move_tcp(target=meeting, arm=GIVING))
perform(pick_up(object=cereal, arm=TAKING, from_=GIVING))
perform(move_arm_joints(arms={"left": "park", "right": "park"}))
perform(moving(target=[-0.3, 1, 0], orientation=[0, 0, 1, 0]))
perform(place(object=cereal, target=[-0.8, 1, 0.94], arm=TAKING))
world.exit()
