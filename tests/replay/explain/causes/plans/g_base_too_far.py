"""Takes the cup from where it stands."""

from household import FACING_COUNTER, drive, kitchen, perform

world = kitchen(cup=[1.4, 0.9, 0.9])
drive([0.1, 0.9, 0], FACING_COUNTER)
perform(type="pick-up", object=world.get_object("cup"), arm="left")  # @cause
world.exit()
