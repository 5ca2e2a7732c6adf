"""Keeps a list of what was taken, for the bill."""

from household import kitchen, perform

PRICES = {"milk": 1.29, "cup": None}


class NotForSale(RuntimeError):
    pass


def add_to_bill(carrier, body):
    if PRICES[body.name] is None:
        raise NotForSale(body.name)  # @cause
    print(body.name, PRICES[body.name])


world = kitchen(milk=[1.35, 0.9, 0.95], cup=[1.3, 0.6, 0.9])
event = world.get_attachment_event()
event += add_to_bill
perform(type="pick-up", object=world.get_object("milk"), arm="left")
perform(type="pick-up", object=world.get_object("cup"), arm="right")  # @call
world.exit()
