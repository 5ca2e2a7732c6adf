"""Takes the milk from the front."""

from household import kitchen, perform

world = kitchen(milk=[1.5, 0.9, 0.95], bowl=[1.36, 0.9, 0.89], cup=[1.35, 0.4, 0.9])
perform(type="pick-up", object=world.get_object("milk"), arm="left", grasp="front")  # @cause
world.exit()
