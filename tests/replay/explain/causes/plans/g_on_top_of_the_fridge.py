"""Fetches the cereal from the top of the fridge."""

from household import FACING_COUNTER, drive, kitchen, perform

world = kitchen(cereal=[1.6, -1.0, 1.625])
drive([0.6, -1.0, 0], FACING_COUNTER)
cereal = world.get_object("cereal")
perform(type="looking", object=cereal)
perform(type="pick-up", object=cereal, arm="left")  # @cause
world.exit()
