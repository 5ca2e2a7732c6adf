"""Rises, and takes the cereal from the fridge."""

from household import kitchen, perform

from pycram.failures import UsageError

world = kitchen(cereal=[1.6, -1.0, 1.62])
robot = world.robot
robot.set_position([0.85, -1.0, 0])


def rise():
    try:
        robot.set_joint_position("torso_lift_jiont", 0.31)  # @swallowed
    except UsageError:
        return


rise()
perform(type="looking", target=[1.6, -1.0, 1.62])  # @on
perform(type="pick-up", object=world.get_object("cereal"), arm="left")  # @use
world.exit()
