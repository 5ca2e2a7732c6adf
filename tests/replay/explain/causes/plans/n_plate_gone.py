"""Looks for the plate that it has cleared away."""

from household import kitchen, perform

world = kitchen(plate=[1.35, 0.9, 0.89], cup=[1.35, 0.5, 0.9])
plate = world.get_object("plate")
perform(type="looking", object=plate)
plate.remove()  # @cause
perform(type="pick-up", object=world.get_object("cup"), arm="right")
found = perform(type="detecting", object_type="plate")  # @use
perform(type="pick-up", object=found, arm="left")
world.exit()
