"""Knows that it reaches the milk; then somebody opens a new one."""

from household import kitchen, perform, put

from pycram import bullet_world_reasoning as btr

world = kitchen(milk=[1.35, 0.9, 0.95], cup=[1.35, 0.5, 0.9])
assert btr.reachable_object(world.get_object("milk"), world.robot, "l_gripper_tool_frame")  # @asked
perform(type="pick-up", object=world.get_object("cup"), arm="right")
world.get_object("milk").remove()  # @removed
put("milk", [1.75, 0.95, 0.95])  # @changed
world.settle()
perform(type="pick-up", object=world.get_object("milk"), arm="left")  # @use
world.exit()
