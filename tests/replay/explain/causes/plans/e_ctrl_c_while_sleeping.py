"""Gives the guests a minute."""

import time

from household import kitchen, park

world = kitchen(cup=[1.35, 0.9, 0.9])
park()
print("waiting a minute", flush=True)
time.sleep(600)  # @cause
park()
