"""Lets the soup cool down, until the batch system ends it."""

from household import kitchen, perform

world = kitchen(pot=[1.5, 0.8, 0.915])


def cool_down(hours):
    print("cooling down", flush=True)
    for _ in range(hours * 3600):
        world.simulate(0.25)  # @cause


perform(type="looking", object=world.get_object("pot"))
cool_down(2)
