# holds: at end distance(milk, cereal) > 14 cm
# holds: at end abs(milk.x - cereal.x) < 2 cm
# holds: at end milk.y > 0 and cereal.y > 0
"""A UR5 puts two cartons into a row on the other side of its table."""

from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import move_arm_joints, pick_up, place

START = [0.45, 0.2]  # of the row, m
SPACING = 0.18
NAMES = ["milk", "cereal"]

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
Object("table", "environment", "table.urdf")
world.robot = robot = Object("ur5", "robot", "ur5.urdf", [0, 0, 0.72])
(arm,) = robot.description.arms
robot.set_joint_positions(robot.description.arm(arm).posture("park"))
Object("milk", "milk", "milk.stl", [0.5, -0.2, 0.83])
Object("cereal", "cereal", "breakfast_cereal.stl", [0.45, -0.45, 0.85])
world.settle()


def positions(count, start, spacing):
    return [[start[0], start[1] + spacing * number] for number in range(count)]


row = positions(len(NAMES), START, SPACING)
for index in range(len(NAMES)):
    thing = world.get_object(NAMES[index])
    height = thing.get_position()[2]
    x, y = row[index]
    perform(pick_up(object=thing, arm=arm))
    perform(place(object=thing, target=[x, y, height], arm=arm))
    perform(move_arm_joints(arms={arm: "park"}))
    assert abs(thing.get_position()[1] - y) < 0.03
world.exit()
