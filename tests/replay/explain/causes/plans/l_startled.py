"""Carries the milk; the bell rings, and it is to be put down."""

from household import kitchen, perform

from pycram.event import Event

world = kitchen(milk=[1.35, 0.9, 0.95])
milk, robot = world.get_object("milk"), world.robot


def drop_all(by):
    robot.detach(milk)  # @cause


bell = Event("bell", "door")
bell += drop_all
perform(type="pick-up", object=milk, arm="left")
bell.fire("guest")  # @fires
perform(type="place", object=milk, target=[1.35, 0.95, 0.95], arm="left")  # @use
world.exit()
