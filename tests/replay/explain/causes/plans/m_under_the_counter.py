"""Reaches into the cupboard below the counter, through its front."""

from household import kitchen, perform

world = kitchen()
perform(type="move-tcp", target=[1.25, 0.9, 0.7], orientation=[0, 0, 0, 1], arm="left")  # @cause
world.exit()
