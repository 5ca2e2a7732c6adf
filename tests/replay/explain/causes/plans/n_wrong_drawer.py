"""Opens the drawer with a joint whose name it doesn't know well."""

from household import kitchen, perform

from pycram.failures import PlanFailure, UsageError

world = kitchen(spoon=[1.4, 0.89, 0.72])
try:
    perform(  # @swallowed
        type="accessing",
        drawer_joint="sink_area_left_upper_drawer_joint",
        drawer_handle="sink_area_left_upper_drawer_handle",
        part_of=world.get_object("kitchen"),
        arm="left",
    )
except (PlanFailure, UsageError) as failure:
    print(failure)
perform(type="pick-up", object=world.get_object("spoon"), arm="right")  # @use
world.exit()
