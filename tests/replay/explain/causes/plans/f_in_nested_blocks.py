"""Each hand has a small plan of its own, within a larger one."""

from household import kitchen, perform

from pycram.language import par, seq, try_in_order

world = kitchen(bottle=[1.75, 1.1, 0.98], bowl=[1.3, 0.6, 0.89])
bowl = world.get_object("bowl")
with seq:
    perform(type="looking", object=bowl)
    with par:
        with try_in_order:
            perform(type="pick-up", object=world.get_object("bottle"), arm="left", grasp="front")  # @first
            perform(type="pick-up", object=world.get_object("bottle"), arm="left", grasp="top")  # @second
        with seq:
            perform(type="pick-up", object=bowl, arm="right")
            perform(type="place", object=bowl, target=[0.95, 0.4, 0.89], arm="right")  # @third
world.exit()
