"""Tries again and again to get the cup, within a second of simulated time."""

from household import kitchen, perform

from pycram.failures import PlanFailure
from pycram.language import failure_handling, timeout

world = kitchen(cup=[1.75, 0.9, 0.9])
cup = world.get_object("cup")


def pause(failure):
    world.simulate(0.4)  # @takes


with timeout(1, simulated=True):
    for attempt in failure_handling(20).on(PlanFailure, pause):
        with attempt:
            perform(type="pick-up", object=cup, arm="left")  # @fails
world.exit()
