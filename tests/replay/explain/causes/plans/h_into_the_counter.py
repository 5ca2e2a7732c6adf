"""Takes the cereal and lowers it, too far."""

from household import kitchen, perform

world = kitchen(cereal=[1.35, 0.8, 0.965])
cereal = world.get_object("cereal")
perform(type="pick-up", object=cereal, arm="left")
x, y, z = world.robot.get_link_position("l_gripper_tool_frame")
for lower in (-0.1, -0.05, 0.04):
    perform(type="move-tcp", target=[x, y, z - lower], orientation=[0, 0, 0, 1], arm="left")  # @cause
world.exit()
