"""A Panda takes the bottle from the far end of its table."""

from household import perform, table

world = table("panda", apple=[0.45, 0.2, 0.757], bottle=[0.88, -0.7, 0.85])
perform(type="pick-up", object=world.get_object("apple"))
perform(type="place", object=world.get_object("apple"), target=[0.4, 0.4, 0.76])
perform(type="pick-up", object=world.get_object("bottle"))  # @cause
world.exit()
