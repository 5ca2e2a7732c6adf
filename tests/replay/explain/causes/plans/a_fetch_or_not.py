"""Brings the milk to the island."""

from household import FACING_ISLAND, ISLAND, drive, kitchen, perform

from pycram.failures import PlanFailure
from pycram.language import failure_handling

world = kitchen(milk=[1.72, 1, 0.95], cup=[1.35, 0.5, 0.9])
milk = world.get_object("milk")


def fetch(body):
    try:
        for attempt in failure_handling(1):
            with attempt:
                perform(type="pick-up", object=body, arm="left")  # @swallowed
    except PlanFailure:
        print("didn't get", body.name, "at first try")


fetch(milk)
drive(ISLAND, FACING_ISLAND)
perform(type="place", object=milk, target=[-0.8, 1, 0.95], arm="left")  # @use
world.exit()
