# holds: at end kitchen.sink_area_left_upper_drawer_main_joint < 1 cm
# holds: at end distance(spoon, [1.35, 1, 0.87]) < 10 cm
"""Takes the spoon out of the drawer, lays it onto the counter, and shuts the drawer."""

from pycram import perform
from pycram.action_designators import closing, opening, transporting
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure

DRAWER = "sink left upper drawer"
JOINT = "sink_area_left_upper_drawer_main_joint"
OPEN = 0.25

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
kitchen = Object("kitchen", "environment", "kitchen.urdf")
spoon = Object("spoon", "spoon", "spoon.stl", [1.4, 0.89, 0.72])
world.robot = Object("pr2", "robot", "pr2.urdf", [0.5, 0.9, 0])
world.settle()

before = spoon.get_position()
perform(opening(container=DRAWER))
moved = before[0] - spoon.get_position()[0]
if moved < OPEN / 2:
    raise PlanFailure(f"the drawer took the spoon along by {moved:.2f} m only")
edge = kitchen.get_AABB("sink_area_surface")[0][0]
top = kitchen.get_AABB("sink_area_surface")[1][2]
perform(transporting(object=spoon, target=[edge + 0.12, 1, top + 0.02]))
perform(closing(container=DRAWER))
assert kitchen.get_joint_position(JOINT) < 0.01
world.exit()
