"""Two branches, each of which takes something when the left hand is free."""

from household import kitchen, perform

from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.fluents.world import holding
from pycram.language import par

world = kitchen(cup=[1.35, 0.95, 0.9], apple=[1.35, 0.75, 0.89])
left, coffee = holding(world.robot, "left"), Fluent(None, "coffee_ready")


def take_cup():
    if left.get_value() is not None:  # @asked
        raise PlanFailure("no hand free")
    coffee.wait_for(timeout=10)
    perform(type="pick-up", object=world.get_object("cup"), arm="left")  # @use


def take_apple():
    perform(type="pick-up", object=world.get_object("apple"), arm="left")  # @changed
    coffee.set_value(True)


with par as s:
    s(take_cup)
    s(take_apple)
