"""Puts the lower of two things that stand on each other elsewhere, later takes the upper one."""

from household import FACING_COUNTER, drive, kitchen, perform, put

world = kitchen(cereal=[1.3, 0.8, 0.965])
glass = put("glass", [1.3, 0.8, 1.144])
world.settle()
cereal = world.get_object("cereal")

drive([0.3, 0.8, 0], FACING_COUNTER)
cereal.set_position([1.3, 1.2, 0.965])  # @cause
world.simulate(2)
drive([0.65, 0.7, 0], FACING_COUNTER)
perform(type="pick-up", object=glass, arm="right")  # @use
world.exit()
