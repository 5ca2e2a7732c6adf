"""Pulls out the drawer beside a bottle on the floor."""

from household import kitchen, perform

world = kitchen(bottle=[1.05, 1.05, 0.13])
world.get_object("bottle").set_position([1.0, 0.9, 0.13])
pot = world.get_object("kitchen")
perform(  # @cause
    type="accessing",
    drawer_joint="sink_area_left_bottom_drawer_main_joint",
    drawer_handle="sink_area_left_bottom_drawer_handle",
    part_of=pot,
    arm="left",
    distance=0.4,
)
world.exit()
