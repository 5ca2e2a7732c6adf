"""Whenever something is taken, the rest is put back; then the cup is to be taken."""

from household import kitchen, perform

world = kitchen(milk=[1.35, 0.9, 0.95], cup=[1.3, 0.6, 0.9])
milk, cup = world.get_object("milk"), world.get_object("cup")


def tidy(carrier, body):
    if body is milk:
        cup.set_position([1.75, 1.2, 0.9])  # @cause


event = world.get_attachment_event()
event += tidy
perform(type="pick-up", object=milk, arm="left")  # @fires
perform(type="pick-up", object=cup, arm="right")  # @use
world.exit()
