"""Puts the cup into the left hand, and from there onto the counter."""

from household import kitchen, perform

from pycram.failures import UsageError

world = kitchen(cup=[1.3, 0.8, 0.9])
cup, robot = world.get_object("cup"), world.robot
try:
    robot.attach(cup, "l_gripper_tool_frmae")  # @swallowed
except UsageError:
    print("it is in the hand, or isn't it?")
perform(type="looking", object=cup)  # @on
perform(type="place", object=cup, target=[1.3, 0.7, 0.9], arm="left")  # @use
world.exit()
