"""Takes the bottle with whichever arm gets it, and puts it beside the sink."""

from household import kitchen, perform

from pycram.language import try_all

world = kitchen(bottle=[1.45, 1.7, 1.65], bowl=[1.3, 0.5, 0.89])  # on the oven
bottle = world.get_object("bottle")

problems = []
with try_all(problems):
    perform(type="pick-up", object=bottle, arm="left")  # @swallowed
    perform(type="pick-up", object=bottle, arm="right")  # @swallowed_too

perform(type="place", object=bottle, target=[1.35, 0.8, 0.98], arm="left")  # @use
world.exit()
