"""Pours the milk away and opens a new one, and takes the one that it knows."""

from household import kitchen, perform, put

world = kitchen(milk=[1.35, 0.9, 0.95])
milk = world.get_object("milk")
perform(type="looking", object=milk)


def replace(thing):
    position = thing.get_position()
    thing.remove()  # @removed
    put(thing.name, position)  # @loaded


replace(milk)
perform(type="pick-up", object=milk, arm="left")  # @use
world.exit()
