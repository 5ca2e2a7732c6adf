"""A guest comes and puts the cereal before the bottle, which is to be taken."""

from household import kitchen, perform

from pycram.event import Event

world = kitchen(bottle=[1.45, 0.8, 0.98], cereal=[1.5, 1.1, 0.98])
bottle, cereal = world.get_object("bottle"), world.get_object("cereal")
guest = Event("guest", "door")


def set_down(name):
    cereal.set_position_and_orientation([1.33, 0.8, 0.98], [0, 0, 0.7071068, 0.7071068])  # @cause


guest += set_down
perform(type="looking", object=bottle)
guest.fire("Anna")  # @fires
perform(type="pick-up", object=bottle, arm="left", grasp="front")  # @use
world.exit()
