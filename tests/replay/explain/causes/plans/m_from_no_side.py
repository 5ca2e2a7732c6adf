"""Takes the milk from whichever side it goes."""

from household import kitchen, perform

world = kitchen(milk=[1.75, 1.0, 0.95])
perform(type="pick-up", object=world.get_object("milk"), arm="right")  # @cause
world.exit()
