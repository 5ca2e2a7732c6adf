"""Rises to look over the counter."""

from household import kitchen

world = kitchen()
for height in (0.1, 0.2, 0.3, 0.4):
    world.robot.set_joint_position("torso_lift_joint", height)  # @cause
world.exit()
