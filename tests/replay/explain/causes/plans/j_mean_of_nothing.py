"""Drives to the middle of all plates."""

import math

from household import kitchen, perform

world = kitchen(cup=[1.35, 0.9, 0.9])
plates = [body.get_position() for body in world.get_objects_by_type("plate")]
middle = sum(y for _, y, _ in plates) / len(plates) if plates else math.nan
perform(type="moving", target=[0.65, middle, 0])  # @cause
world.exit()
