import random

from scene import build

from pycram import perform
from pycram.action_designators import fetching

with build() as world:
    milk = world.get_object("milk")
    milk.set_position([random.uniform(1.25, 1.5), random.uniform(0.4, 1.2), 0.948])
    perform(fetching(object=milk))
