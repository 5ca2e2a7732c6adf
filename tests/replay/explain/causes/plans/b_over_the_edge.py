"""Sets the cup down at the front of the counter by hand, then takes it again."""

from household import kitchen, perform

world = kitchen(cup=[1.4, 0.9, 0.9], bowl=[1.4, 0.5, 0.89])
cup, robot = world.get_object("cup"), world.robot

perform(type="pick-up", object=cup, arm="left")
perform(type="move-tcp", target=[1.2, 0.9, 1.0], arm="left")
robot.detach(cup)  # @cause
perform(type="move-arm-joints", left_arm="park")
world.simulate(1)
perform(type="pick-up", object=cup, arm="left")  # @use
world.exit()
