"""Tries to take the milk until it works; its first attempts fail, and then somebody has had enough."""

import time

from household import kitchen, perform

from pycram.failures import Unreachable
from pycram.language import failure_handling

world = kitchen(milk=[1.75, 0.9, 0.95])


def breathe(failure):
    print("trying again in a while", flush=True)
    time.sleep(600)  # @cause


for attempt in failure_handling(50).on(Unreachable, breathe):
    with attempt:
        perform(type="pick-up", object=world.get_object("milk"), arm="left")
