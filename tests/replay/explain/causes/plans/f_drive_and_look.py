"""Drives up to the fridge and looks at the ceiling meanwhile."""

from household import kitchen, perform

from pycram.language import par, seq

world = kitchen(cup=[1.35, 0.9, 0.9])
with par:
    with seq:
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        perform(type="moving", target=[1.1, -1.0, 0])  # @first
    perform(type="detecting", object_type="apple")  # @second
world.exit()
