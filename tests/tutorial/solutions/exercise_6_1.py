from scene import build

from pycram import perform
from pycram.motion_designators import move_arm_joints, moving, pick_up, place

ARMS = {"milk": "left", "bowl": "right"}
SPOTS = {"milk": [-0.8, 1.0, 0.95], "bowl": [-0.8, 0.6, 0.89]}


def bring(thing):
    arm = ARMS[thing.name]
    x, y, _ = thing.get_position()
    perform(moving(target=[x - 0.7, y, 0], orientation=[0, 0, 0, 1]))
    perform(pick_up(object=thing, arm=arm))
    perform(move_arm_joints(arms={arm: "park"}))
    x, y, z = SPOTS[thing.name]
    perform(moving(target=[x + 0.7, y, 0], orientation=[0, 0, 1, 0]))
    perform(place(object=thing, target=[x, y, z], arm=ARMS[thing.name]))
    perform(move_arm_joints(arms={arm: "park"}))


with build() as world:
    perform(move_arm_joints(arms={"left": "park", "right": "park"}))
    for name in SPOTS:
        bring(world.get_object(name))
