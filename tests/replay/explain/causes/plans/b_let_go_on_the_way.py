"""Takes the milk, and is polite: relaxes its hands on the way."""

from household import FACING_ISLAND, ISLAND, drive, kitchen, perform

world = kitchen(milk=[1.35, 0.9, 0.95])
milk = world.get_object("milk")

perform(type="pick-up", object=milk, arm="left")
drive([0.2, 0.8, 0], FACING_ISLAND)
for hand in ("right", "left"):
    perform(type="opening-gripper", gripper=hand)  # @cause
drive(ISLAND, FACING_ISLAND)
perform(type="place", object=milk, target=[-0.8, 1, 0.95], arm="left")  # @use
world.exit()
