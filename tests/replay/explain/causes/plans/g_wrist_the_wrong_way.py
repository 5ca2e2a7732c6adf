"""Points the right hand back at the robot's own shoulder."""

from household import kitchen, perform

world = kitchen()
for turned in ([0, 0, 0, 1], [0, 0, 1, 0]):
    perform(type="move-tcp", target=[1.35, 0.5, 1.1], orientation=turned, arm="right")  # @cause
world.exit()
