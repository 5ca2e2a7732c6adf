"""Brings the milk to the front by the mean of where guests want it, and takes it."""

from household import kitchen, perform

from pycram.failures import UsageError

WISHES: list[float] = []

world = kitchen(milk=[1.75, 0.9, 0.95], cup=[1.3, 0.6, 0.9])
milk = world.get_object("milk")
mean = sum(WISHES) / len(WISHES) if WISHES else float("nan")
try:
    milk.set_position([1.35, mean, 0.95])  # @swallowed
except UsageError:
    print("whatever")
perform(type="pick-up", object=world.get_object("cup"), arm="right")  # @on
perform(type="pick-up", object=milk, arm="left")  # @use
world.exit()
