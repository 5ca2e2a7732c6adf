# holds: at end on(cereal, kitchen)
# holds: at end cereal.x < 0
"""A TIAGo Pro looks for the cereal, fetches it, and delivers it to the island."""

from pycram import perform
from pycram.action_designators import delivering, fetching
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import LocationDesignator

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
Object("kitchen", "environment", "kitchen.urdf")
Object("cereal", "cereal", "breakfast_cereal.stl", [1.35, 0.6, 0.98])
Object("milk", "milk", "milk.stl", [1.35, 1.1, 0.97])
world.robot = Object("tiago_pro", "robot", "tiago_pro.urdf")
world.settle()

perform(fetching(object="cereal"))
perform(delivering(object="cereal", target=LocationDesignator(on="island")))
(cereal,) = world.get_objects_by_type("cereal")
x, y, z = cereal.get_position()
if not (x < 0 and z > 0.8):
    raise RuntimeError("the cereal isn't on the island")
world.exit()
