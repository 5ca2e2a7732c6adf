"""Eats the apple, and takes it."""

from household import kitchen, perform

from pycram.language import par

world = kitchen(apple=[1.35, 0.9, 0.89], cup=[1.35, 0.6, 0.9])
apple = world.get_object("apple")


def eat():
    apple.remove()  # @removed


with par as s:
    s(perform, type="pick-up", object=world.get_object("cup"), arm="right")
    s(eat)
perform(type="pick-up", object=apple, arm="left")  # @cause
world.exit()
