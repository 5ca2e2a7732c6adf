"""Bows to the guests, then takes the cereal from the shelf."""

from household import kitchen, perform

world = kitchen(cup=[1.35, 0.5, 0.9])
robot = world.robot


def bow():
    robot.set_joint_position("torso_lift_joint", 0.0)  # @cause


robot.set_joint_position("torso_lift_joint", 0.3)
perform(type="move-tcp", target=[1.0, 0.9, 1.75], arm="left")
perform(type="move-arm-joints", left_arm="park")
bow()
perform(type="move-tcp", target=[1.0, 0.9, 1.75], arm="left")  # @use
world.exit()
