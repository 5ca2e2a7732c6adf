"""A dinner with a contract: what goes wrong below is told in its own words."""

from household import kitchen, perform

from pycram.failures import PlanFailure, Unreachable

world = kitchen(milk=[1.75, 0.9, 0.95], bowl=[1.35, 0.5, 0.89])


class DinnerCancelled(PlanFailure):
    """Nobody gets anything."""


def fetch(name, arm):
    try:
        perform(type="pick-up", object=world.get_object(name), arm=arm)  # @inner
    except Unreachable as failure:
        raise DinnerCancelled(f"no {name}, no dinner") from failure  # @cause


fetch("bowl", "right")
fetch("milk", "left")
world.exit()
