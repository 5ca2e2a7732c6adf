"""Puts the milk where the pot stands, whichever way it is turned."""

from household import kitchen, perform

world = kitchen(milk=[1.3, 0.9, 0.95], pot=[1.4, 0.5, 0.95])
milk = world.get_object("milk")
perform(type="pick-up", object=milk, arm="left")
perform(type="place", object=milk, target=[1.4, 0.55, 0.95], arm="left")  # @cause
world.exit()
