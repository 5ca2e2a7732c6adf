"""Takes the cereal."""

from household import kitchen, perform

world = kitchen(cereal=[1.35, 0.7, 0.965], cup=[1.35, 0.9, 0.9])
for name in ("cup", "cerial"):
    perform(type="looking", object=world.get_object(name))  # @cause
world.exit()
