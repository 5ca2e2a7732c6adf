"""Opens the fridge from where the robot stands."""

from household import FACING_COUNTER, drive, kitchen, perform

world = kitchen()
drive([0.1, -0.2, 0], FACING_COUNTER)
perform(  # @cause
    type="accessing",
    drawer_joint="iai_fridge_door_joint",
    drawer_handle="iai_fridge_door_handle",
    part_of=world.get_object("kitchen"),
    arm="right",
    distance=1.0,
)
world.exit()
