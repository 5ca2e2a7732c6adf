"""Stirs until the soup is done."""

from household import kitchen, perform

from pycram.language import timeout

world = kitchen(pot=[1.45, 0.8, 0.915])


def stir(rounds):
    for _ in range(rounds):
        world.simulate(0.05)  # @wait


perform(type="looking", object=world.get_object("pot"))
with timeout(1, simulated=True):
    stir(200)
world.exit()
