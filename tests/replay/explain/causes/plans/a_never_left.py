"""Carries the cereal over to the island."""

import logging

from household import FACING_ISLAND, kitchen, park, perform

from pycram.failures import InCollision
from pycram.language import seq

world = kitchen(cereal=[1.35, 0.7, 0.965])
cereal = world.get_object("cereal")

with seq:
    perform(type="pick-up", object=cereal, arm="right")
    park()
try:
    perform(type="moving", target=[-0.6, 1, 0], orientation=FACING_ISLAND)  # @swallowed
except InCollision:
    logging.getLogger("plan").info("close enough")
perform(type="place", object=cereal, target=[-0.85, 1, 0.965], arm="right")  # @use
world.exit()
