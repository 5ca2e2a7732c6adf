"""Tells what it can't reach."""

from household import kitchen, perform

from pycram.failures import Unreachable

world = kitchen(milk=[1.75, 0.9, 0.95])
try:
    perform(type="pick-up", object=world.get_object("milk"), arm="left")  # @first
except Unreachable as failure:
    print("out of reach:", failure.thing.name)  # @cause
world.exit()
