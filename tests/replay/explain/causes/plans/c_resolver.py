"""Greets with a designator of its own; where the guest stands is looked up when it is resolved."""

from household import kitchen

from pycram.designator import MotionDesignator
from pycram.process_module import ProcessModule

world = kitchen(cup=[1.35, 0.9, 0.9])
GUESTS = ["Ann, 1.2", "Ben"]


def place_of(guest):
    entry = next(entry for entry in GUESTS if entry.startswith(guest))
    _, distance = entry.split(", ")  # @cause
    return [float(distance), 0.7, 1.2]


def greeting(designator):
    slots = dict(designator.description)
    if slots.get("type") == "greeting":
        yield {"cmd": "looking", "target": place_of(slots["guest"])}


with MotionDesignator.resolvers.added(greeting):
    ProcessModule.perform(MotionDesignator([("type", "greeting"), ("guest", "Ben")]))  # @call
