"""Takes the apple with the hand that is asked for."""

from household import kitchen, perform

world = kitchen(apple=[1.35, 0.9, 0.89])
perform(type="pick-up", object=world.get_object("apple"), hand="left")  # @cause
world.exit()
