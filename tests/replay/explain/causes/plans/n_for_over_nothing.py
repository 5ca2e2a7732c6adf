"""Takes all cups that it sees, then puts the cup away."""

from household import FACING_ISLAND, drive, kitchen, perform

from pycram.failures import PerceptionError

world = kitchen(cup=[1.35, 0.8, 0.9], milk=[-0.8, 1, 0.95])


def see(kind):
    try:
        return [perform(type="detecting", object_type=kind)]  # @swallowed
    except PerceptionError:
        return []


drive([0.3, 0.9, 0], FACING_ISLAND)
cups = see("cup")
drive([0.65, 0.7, 0], [0, 0, 0, 1])
for cup in cups:  # @skipped
    perform(type="pick-up", object=cup, arm="left")
perform(type="place", object=world.get_object("cup"), target=[1.35, 0.95, 0.9], arm="left")  # @use
world.exit()
