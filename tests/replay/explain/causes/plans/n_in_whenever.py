"""Watches the cup while it works; does not want it on the floor."""

from household import kitchen, perform

from pycram.failures import PlanFailure
from pycram.fluent import whenever
from pycram.fluents.world import position
from pycram.language import pursue

world = kitchen(cup=[1.3, 0.9, 0.9], apple=[1.35, 0.6, 0.89])
cup = world.get_object("cup")


class Broken(PlanFailure):
    pass


def inspect():
    height = cup.get_position()[2]
    if height < 0.5:
        raise Broken(f"the cup is at {height:.2f} m")  # @cause


def work():
    perform(type="pick-up", object=world.get_object("apple"), arm="right")
    cup.set_position([1.0, 0.9, 0.05])  # @moved
    perform(type="move-arm-joints", right_arm="park")


with pursue as s:
    s(whenever, position(cup).pulsed(), inspect)
    s(work)
world.exit()
