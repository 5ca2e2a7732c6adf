"""Patrols between the counter and the island until somebody stops it."""

from itertools import cycle

from household import COUNTER, FACING_COUNTER, FACING_ISLAND, ISLAND, kitchen, perform

world = kitchen(milk=[1.35, 0.9, 0.95])
print("on patrol", flush=True)
for place, facing in cycle([(ISLAND, FACING_ISLAND), (COUNTER, FACING_COUNTER)]):
    perform(type="moving", target=place, orientation=facing)  # @cause
