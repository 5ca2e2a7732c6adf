"""Waits until somebody has filled the cup."""

from household import kitchen, perform

from pycram.failures import PlanFailure
from pycram.fluent import Fluent

world = kitchen(cup=[1.35, 0.9, 0.9])
level = Fluent(0.1, "fill_level")

level.set_value(0.35)
if not (level > 0.8).wait_for(timeout=0.3):  # @wait
    raise PlanFailure("the cup isn't full")
perform(type="pick-up", object=world.get_object("cup"), arm="left")
world.exit()
