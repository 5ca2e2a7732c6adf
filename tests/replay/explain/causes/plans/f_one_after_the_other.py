"""Tries places for the cereal, the best one first."""

from household import kitchen, perform

from pycram.language import try_in_order

world = kitchen(cereal=[1.3, 0.7, 0.965], pot=[1.5, 0.9, 0.915])
cereal = world.get_object("cereal")
perform(type="pick-up", object=cereal, arm="left")
with try_in_order:
    perform(type="place", object=cereal, target=[1.5, 0.9, 0.965], arm="left")  # @first
    perform(type="place", object=cereal, target=[0.9, 1.1, 0.965], arm="left")  # @second
    perform(type="place", object=cereal, target=[-0.8, 1.0, 0.965], arm="left")  # @third
world.exit()
