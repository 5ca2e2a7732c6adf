"""Holds the cereal with the right hand, and brings the left one to the same place."""

from household import kitchen, perform

world = kitchen(cereal=[1.3, 0.7, 0.965])
cereal = world.get_object("cereal")
perform(type="pick-up", object=cereal, arm="right")
perform(type="move-tcp", target=[1.1, 0.6, 1.05], orientation=[0, 0, 0, 1], arm="right")
perform(type="move-tcp", target=[1.15, 0.63, 1.1], orientation=[0, 0, -0.7071, 0.7071], arm="left")  # @cause
world.exit()
