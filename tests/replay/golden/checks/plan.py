"""A small plan whose recording has properties and their violations.

``pycram run tests/replay/golden/checks/plan.py --check tests/replay/golden/checks/table.properties --check-only-record``
"""

from pathlib import Path

from pycram import monitored
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PropertyViolated

CARTON = str(Path(__file__).parent.parent / "carton.stl")

with BulletWorld(name="table") as world:
    world.set_gravity([0, 0, -9.8])
    milk = Object("milk", "milk", CARTON, [0, 0, 0.5])
    try:
        with monitored("milk.z < 1 until milk.x > 1"):
            milk.set_position([0, 0, 1.5])
            milk.set_position([2, 0, 1.5])
    except PropertyViolated:
        milk.set_position([0, 0, 0.5])
    world.simulate(0.3)
