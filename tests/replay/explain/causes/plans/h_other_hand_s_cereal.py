"""Holds the cereal with the right hand, and brings the left one beside it."""

from household import kitchen, perform

world = kitchen(cereal=[1.3, 0.7, 0.965])
cereal = world.get_object("cereal")
perform(type="pick-up", object=cereal, arm="right")
perform(type="move-tcp", target=[1.2, 0.65, 1.1], orientation=[0, 0, 0, 1], arm="right")
perform(type="move-tcp", target=[1.3, 0.68, 1.15], orientation=[0, 0, 0, 1], arm="left")  # @cause
world.exit()
