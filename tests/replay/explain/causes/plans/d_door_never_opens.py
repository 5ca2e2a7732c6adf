"""Waits for the door, then drives through."""

from household import kitchen, perform

from pycram.fluent import Fluent
from pycram.language import timeout

world = kitchen()
kitchen_door = Fluent("closed", "kitchen_door")

with timeout(0.3):
    (kitchen_door == "open").wait_for()  # @wait
    perform(type="moving", target=[0.2, 0.7, 0])
world.exit()
