"""Loads the dish washer's door with a plate, and closes it before the plate is taken."""

from household import FACING_COUNTER, drive, kitchen, perform, put

world = kitchen()
furniture = world.get_object("kitchen")
drive([0.1, 0.9, 0], FACING_COUNTER)
furniture.set_joint_position("sink_area_dish_washer_door_joint", 1.5708)
plate = put("plate", [0.95, 0.19, 0.156])
world.settle()
for angle in (1.2, 0.8, 0.4, 0):
    furniture.set_joint_position("sink_area_dish_washer_door_joint", angle)  # @cause
    world.simulate(0.25)
world.settle()
drive([0.5, 0.2, 0], FACING_COUNTER)
perform(type="pick-up", object=plate, arm="right", grasp="front")  # @use
world.exit()
