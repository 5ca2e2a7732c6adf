"""Takes the pot round its belly."""

from household import kitchen, perform

world = kitchen(pot=[1.35, 0.9, 0.915], milk=[1.3, 0.5, 0.95])
perform(type="pick-up", object=world.get_object("milk"), arm="right")
perform(type="pick-up", object=world.get_object("pot"), arm="left", grasp="front")  # @cause
world.exit()
