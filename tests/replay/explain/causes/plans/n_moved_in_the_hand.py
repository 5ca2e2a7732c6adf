"""Tidies the counter by hand, though the milk is in the robot's hand."""

from household import kitchen, perform

world = kitchen(milk=[1.35, 0.9, 0.95], cup=[1.35, 0.5, 0.9])
milk = world.get_object("milk")
perform(type="pick-up", object=milk, arm="left")
for number, name in enumerate(("milk", "cup")):
    world.get_object(name).set_position([1.35, 1.7 - 0.4 * number, 0.95])  # @cause
perform(type="place", object=milk, target=[1.35, 0.4, 0.95], arm="left")  # @use
world.exit()
