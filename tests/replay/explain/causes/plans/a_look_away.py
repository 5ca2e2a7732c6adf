"""Looks back over its shoulder at the milk, and takes what it sees."""

from contextlib import suppress

from household import FACING_ISLAND, drive, kitchen, perform

from pycram.failures import LookingFailed

world = kitchen(milk=[1.35, 0.9, 0.95])
drive([0.3, 0.9, 0], FACING_ISLAND)

with suppress(LookingFailed):
    perform(type="looking", target=[1.35, 0.9, 0.95])  # @swallowed
found = perform(type="detecting", object_type="milk")  # @use
perform(type="pick-up", object=found, arm="left")
world.exit()
