"""Asks whether it reaches the milk, parks elsewhere for the camera, and takes it."""

from household import FACING_COUNTER, drive, kitchen, perform

from pycram import bullet_world_reasoning as btr

world = kitchen(milk=[1.35, 0.9, 0.95])
milk = world.get_object("milk")
if btr.reachable_object(milk, world.robot, "l_gripper_tool_frame"):  # @asked
    drive([0.2, 0.3, 0], FACING_COUNTER)  # @changed
    perform(type="looking", object=milk)
    perform(type="pick-up", object=milk, arm="left")  # @use
world.exit()
