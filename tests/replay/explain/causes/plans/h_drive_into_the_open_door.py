"""Looks what is in the larder, then drives along the counter."""

from household import kitchen, perform

world = kitchen(cup=[1.35, 0.9, 0.9])
furniture = world.get_object("kitchen")
furniture.set_joint_position("oven_area_area_left_drawer_main_joint", 0.45)
perform(type="moving", target=[0.4, 1.6, 0])
perform(type="moving", target=[0.65, 2.3, 0])  # @cause
world.exit()
