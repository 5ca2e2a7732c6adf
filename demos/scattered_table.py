"""Sets the table of ``set_the_table`` with other places of the objects in each run.

``pycram sweep scattered_table.py --runs 500 --set scatter=0.02,0.05 -o runs`` runs the plan with 500 seeds.
"""

from __future__ import annotations

import random

import set_the_table

import pycram
from pycram.bullet_world import BulletWorld

SCATTERED = ("milk", "cereal", "bowl")  # the drawer of the spoon has no room


def scatter(distance: float) -> None:
    """Moves the objects on the counter by up to a distance, in m, along x and along y."""
    world = BulletWorld.current_bullet_world
    for kind in SCATTERED:
        body = world.get_objects_by_type(kind)[0]
        x, y, z = body.get_position()
        body.set_position([x + random.uniform(-distance, distance), y + random.uniform(-distance, distance), z])
    world.settle()


def main() -> None:
    distance = pycram.parameters(scatter=0.03).scatter
    kitchen = set_the_table.build_scene()
    scatter(distance)
    set_the_table.set_table(kitchen)
    print("the table is set")
    BulletWorld.current_bullet_world.exit()


if __name__ == "__main__":
    main()
