"""Picks up, drinks, and puts down what it drank."""

from household import kitchen, perform, put

world = kitchen(milk=[1.35, 0.9, 0.95])
milk = world.get_object("milk")
perform(type="pick-up", object=milk, arm="left")
milk.remove()  # @removed
put("milk", [1.35, 0.5, 0.95])
perform(type="place", object=milk, target=[1.35, 0.9, 0.95], arm="left")  # @use
world.exit()
