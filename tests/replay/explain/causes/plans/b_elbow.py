"""Points at the bottle with the right hand, comes nearer, and takes it with the left."""

from household import kitchen, park, perform

world = kitchen(bottle=[1.3, 0.7, 0.98])
bottle, robot = world.get_object("bottle"), world.robot

perform(type="move-tcp", target=[1.18, 0.68, 0.99], orientation=[0, 0, 0, 1], arm="right")
for x in (0.7, 0.75, 0.8):
    robot.set_position([x, 0.7, 0])  # @moved
    world.simulate(0.5)  # @cause
robot.set_position([0.45, 0.7, 0])
park()
perform(type="pick-up", object=bottle, arm="left")  # @use
world.exit()
