"""Pulls the drawer out by hand, and takes the spoon out of it."""

from contextlib import suppress

from household import kitchen, perform

from pycram.failures import UsageError

world = kitchen(spoon=[1.4, 0.89, 0.72])
spoon, cupboard = world.get_object("spoon"), world.get_object("kitchen")
with suppress(UsageError):
    cupboard.set_joint_positions({"sink_area_left_uper_drawer_main_joint": 0.4})  # @swallowed
perform(type="looking", object=spoon)  # @on
perform(type="pick-up", object=spoon, arm="right")  # @use
world.exit()
