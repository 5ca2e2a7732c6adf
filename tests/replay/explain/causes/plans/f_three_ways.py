"""Gets a drink in any of three ways."""

from household import kitchen, perform

from pycram.failures import PlanFailure
from pycram.language import try_all

world = kitchen(milk=[1.72, 1.0, 0.95], cup=[1.3, 0.6, 0.9])


def order_online():
    raise PlanFailure("the shop is closed on Sundays")  # @second


with try_all as s:
    perform(type="pick-up", object=world.get_object("milk"), arm="right")  # @first
    s(order_online)
    perform(type="detecting", object_type="bottle")  # @third
world.exit()
