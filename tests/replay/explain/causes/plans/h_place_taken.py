"""Puts the glass where the pot stands."""

from household import kitchen, perform

world = kitchen(glass=[1.32, 0.8, 0.915], pot=[1.5, 0.6, 0.915])
glass, pot = world.get_object("glass"), world.get_object("pot")
perform(type="pick-up", object=glass, arm="right")
perform(type="place", object=glass, target=pot.get_position(), arm="right")  # @cause
world.exit()
