"""Takes the spoon out of its drawer."""

from household import kitchen, perform

from pycram.failures import AccessFailed

world = kitchen(spoon=[1.4, 0.89, 0.72])
furniture, spoon = world.get_object("kitchen"), world.get_object("spoon")
perform(type="moving", target=[0.1, 0.7, 0])

drawer = "sink_area_left_upper_drawer"
try:
    perform(  # @swallowed
        type="accessing",
        drawer_joint=f"{drawer}_main_joint",
        drawer_handle=f"{drawer}_handle",
        part_of=furniture,
        arm="left",
        distance=0.3,
    )
except AccessFailed as failure:
    print("perhaps somebody left it open:", type(failure).__name__)

perform(type="moving", target=[0.65, 0.7, 0])
perform(type="pick-up", object=spoon, arm="right")  # @use
world.exit()
