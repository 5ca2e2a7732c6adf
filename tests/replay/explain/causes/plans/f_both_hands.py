"""Takes two things at once."""

from household import kitchen, perform

from pycram.language import par

world = kitchen(milk=[1.72, 1.0, 0.95], glass=[1.5, 0.5, 0.915], cereal=[1.36, 0.5, 0.965])
with par:
    perform(type="pick-up", object=world.get_object("milk"), arm="left")  # @first
    perform(type="pick-up", object=world.get_object("glass"), arm="right", grasp="front")  # @second
world.exit()
