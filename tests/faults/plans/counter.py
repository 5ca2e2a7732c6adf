# holds: at end distance(milk, [-0.8, 1, 0.93]) < 5 cm
# holds: at end distance(bowl, [-0.8, 1.25, 0.9]) < 5 cm
# holds: at end distance(cereal, [-1, 1, 0.94]) < 5 cm
"""Carries three things from the counter to the island, one after the other."""

from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import detecting, looking, move_arm_joints, moving, pick_up, place

TARGETS = {"milk": [-0.8, 1, 0.93], "bowl": [-0.8, 1.25, 0.9], "cereal": [-1, 1, 0.94]}
ARMS = {"milk": "left", "bowl": "right", "cereal": "right"}
ORDER = ["bowl", "milk", "cereal"]


def build():
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    Object("kitchen", "environment", "kitchen.urdf")
    Object("milk", "milk", "milk.stl", [1.4, 1, 0.97])
    Object("cereal", "cereal", "breakfast_cereal.stl", [1.3, 0.6, 0.98])
    Object("bowl", "bowl", "bowl.stl", [1.3, 0.8, 0.9])
    world.robot = Object("pr2", "robot", "pr2.urdf")
    world.settle()
    return world


def drive(position, orientation):
    perform(move_arm_joints(arms={"left": "park", "right": "park"}))
    perform(moving(target=position, orientation=orientation))


def find(kind, world):
    thing = world.get_objects_by_type(kind)[0]
    perform(looking(object=thing))
    return perform(detecting(object_type=kind))


def carry(kind, world):
    arm, target = ARMS[kind], TARGETS[kind]
    drive([0.65, 0.7, 0], [0, 0, 0, 1])
    found = find(kind, world)
    perform(pick_up(object=found, arm=arm))
    drive([-0.3, 1, 0], [0, 0, 1, 0])
    perform(place(object=found, target=target, arm=arm))
    off = max(abs(a - b) for a, b in zip(found.get_position(), target, strict=True))
    if off > 0.05:
        raise RuntimeError(f"{kind} isn't where it belongs")


scene = build()
for index, kind in enumerate(ORDER):
    carry(kind, scene)
    print(index + 1, "of", len(ORDER))
scene.exit()
