"""Loads the dish washer's door with a plate, and closes it before the plate is taken."""

from household import drive, kitchen, perform, put

world = kitchen()
furniture = world.get_object("kitchen")
furniture.set_joint_position("sink_area_dish_washer_door_joint", 1.5708)
plate = put("plate", [0.95, 0.19, 0.25])
world.settle()
print("the plate lies at", [round(x, 2) for x in plate.get_position()])
furniture.set_joint_position("sink_area_dish_washer_door_joint", 0)  # @cause
world.simulate(2)
drive([0.5, 0.2, 0], [0, 0, 0, 1])
perform(type="looking", target=[1.2, 0.2, 0.8])
perform(type="pick-up", object=plate, arm="right")  # @use
world.exit()
