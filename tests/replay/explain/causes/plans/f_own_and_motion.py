"""Checks the stock while the right arm reaches for the pot."""

from household import kitchen, perform

from pycram.failures import PlanFailure
from pycram.language import par

world = kitchen(pot=[1.65, 0.42, 0.915], apple=[1.3, 0.9, 0.89])


class OutOfStock(PlanFailure):
    pass


def check_stock(kind, needed):
    there = len(world.get_objects_by_type(kind))
    if there < needed:
        raise OutOfStock(f"{needed} of {kind} are needed, {there} there")  # @first


with par as s:
    s(check_stock, "apple", 3)
    s(perform, type="move-tcp", target=world.get_object("pot").get_position(), arm="right")  # @second
world.exit()
