"""Remembers where things are; forgets the one that it didn't see."""

from contextlib import suppress

from household import kitchen, perform

from pycram.failures import PlanFailure

world = kitchen(cup=[1.35, 0.9, 0.9], bowl=[-0.8, 1, 0.89])
known = {}
for kind in ("cup", "bowl"):
    with suppress(PlanFailure):
        known[kind] = perform(type="detecting", object_type=kind)  # @swallowed
perform(type="looking", target=[1.35, 0.9, 0.9])
for kind in ("cup", "bowl"):
    perform(type="pick-up", object=known[kind], arm="left")  # @use
    perform(type="place", object=known[kind], target=[1.35, 0.6, 0.9], arm="left")
world.exit()
