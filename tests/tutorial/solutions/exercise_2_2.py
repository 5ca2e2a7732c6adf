from scene import build

from pycram import perform
from pycram.motion_designators import move_arm_joints, moving, pick_up, place

with build() as world:
    perform(move_arm_joints(arms={"left": "park", "right": "park"}))
    for name, arm, target in (("milk", "left", [-0.8, 1.0, 0.95]), ("bowl", "right", [-0.8, 0.6, 0.89])):
        thing = world.get_object(name)
        x, y, _ = thing.get_position()
        perform(moving(target=[x - 0.7, y, 0], orientation=[0, 0, 0, 1]))
        perform(pick_up(object=thing, arm=arm))
        perform(move_arm_joints(arms={arm: "park"}))
        perform(moving(target=[target[0] + 0.7, target[1], 0], orientation=[0, 0, 1, 0]))
        perform(place(object=thing, target=target, arm=arm))
        perform(move_arm_joints(arms={arm: "park"}))
