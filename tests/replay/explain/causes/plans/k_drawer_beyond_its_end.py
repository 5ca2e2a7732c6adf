"""Pulls the drawer out by hand, and takes the spoon out of it."""

from household import kitchen, perform

from pycram.failures import UsageError

DRAWER = "sink_area_left_upper_drawer_main_joint"

world = kitchen(spoon=[1.4, 0.89, 0.72])
spoon, cupboard = world.get_object("spoon"), world.get_object("kitchen")
try:
    cupboard.set_joint_position(DRAWER, 0.9)  # @swallowed
except UsageError as error:
    print("it sticks:", error)
perform(type="looking", object=spoon)
perform(type="pick-up", object=spoon, arm="right")  # @use
world.exit()
