from scene import build

from pycram import perform
from pycram.motion_designators import move_arm_joints, moving, pick_up

with build() as world:
    milk = world.get_object("milk")
    perform(move_arm_joints(arms={"left": "park", "right": "park"}))
    perform(moving(target=[0.6, 1.0, 0], orientation=[0, 0, 0, 1]))
    perform(pick_up(object=milk, arm="right"))
    perform(move_arm_joints(arms={"right": "park"}))
    perform(moving(target=[0, 0, 0], orientation=[0, 0, 0, 1]))
