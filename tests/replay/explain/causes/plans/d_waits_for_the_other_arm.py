"""The left arm brings the milk, the right one holds the bowl as soon as the milk is there."""

from household import kitchen, perform

from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.language import par, timeout

world = kitchen(milk=[1.75, 0.9, 0.95], bowl=[1.3, 0.5, 0.89])
milk_there = Fluent(None, "milk_there")


def bring():
    try:
        perform(type="pick-up", object=world.get_object("milk"), arm="left")  # @swallowed
        milk_there.set_value(True)
    except PlanFailure:
        print("no milk today")


def hold():
    with timeout(0.5):
        milk_there.wait_for()  # @wait
    perform(type="pick-up", object=world.get_object("bowl"), arm="right")


with par as s:
    s(bring)
    s(hold)
