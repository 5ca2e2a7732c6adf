"""Watches a bowl dry."""

from household import kitchen

world = kitchen(bowl=[1.35, 0.9, 0.89])
for second in range(3600):
    if second == 1:
        print("watching", flush=True)
    world.simulate(0.25)  # @cause
