# holds: at end on(bowl, kitchen)
# holds: at end bowl.x < 0 and milk.x < 0
# holds: always tilt(milk) < 1
"""Brings bowl and milk to the island, wherever there is room."""

from pycram import perform
from pycram.action_designators import transporting
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import LocationDesignator

WANTED = ("bowl", "milk")


def things(world):
    found = []
    for kind in WANTED:
        found += world.get_objects_by_type(kind)
    return found


world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
kitchen = Object("kitchen", "environment", "kitchen.urdf")
Object("bowl", "bowl", "bowl.stl", [1.4, 0.9, 0.89])
Object("milk", "milk", "milk.stl", [1.4, 0.6, 0.97])
world.robot = Object("pr2", "robot", "pr2.urdf")
world.settle()

island = LocationDesignator(on="island")
done = []
for thing in things(world):
    perform(transporting(object=thing, target=island))
    done.append(thing.name)
missing = set(WANTED) - set(done)
if missing:
    raise RuntimeError(f"not brought: {missing}")
for thing in things(world):
    assert thing.get_position()[0] < 0, f"{thing.name} isn't on the island"
world.exit()
