"""Turned to the island, wants the milk from the counter."""

from household import FACING_ISLAND, drive, kitchen, perform

world = kitchen(milk=[1.35, 0.9, 0.95], bowl=[-0.8, 1, 0.89])
drive([0.6, 0.9, 0], FACING_ISLAND)
perform(type="pick-up", object=world.get_object("milk"), arm="right")  # @cause
world.exit()
