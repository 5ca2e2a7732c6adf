# holds: at end cup.y > 0 and glass.y > 0
# holds: at end apple.y < 0.15
# holds: never contact(cup, glass)
"""A Panda sorts things on a table: what one drinks from to the left, the rest stays."""

import math

from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import move_arm_joints, pick_up, place

TABLE = 0.72
SIDE = {"cup": 1, "glass": 1, "apple": -1}
RADIUS = 0.5

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
table = Object("table", "environment", "table.urdf")
world.robot = Object("panda", "robot", "panda.urdf", [0, 0, TABLE])
(arm,) = world.robot.description.arms
perform(move_arm_joints(arms={arm: "park"}))
for number, kind in enumerate(SIDE):
    angle = math.radians(-40 + 25 * number)
    spot = [RADIUS * math.cos(angle), RADIUS * math.sin(angle), TABLE + 0.08]
    Object(kind, kind, f"{kind}.stl", spot)
world.settle()


def slot(number):
    angle = math.radians(30 + 25 * number)
    return [RADIUS * math.cos(angle), RADIUS * math.sin(angle)]


placed = 0
for kind, side in SIDE.items():
    if side < 0:
        continue
    (thing,) = world.get_objects_by_type(kind)
    x, y = slot(placed)
    z = thing.get_position()[2]
    perform(pick_up(object=thing, arm=arm))
    perform(place(object=thing, target=[x, y, z], arm=arm))
    placed += 1
assert placed == 2, placed
perform(move_arm_joints(arms={arm: "park"}))
world.exit()
