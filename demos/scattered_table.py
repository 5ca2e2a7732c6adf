"""Sets the table of ``set_the_table`` from other places each time: one plan, many runs.

``pycram sweep scattered_table.py --runs 500 --set scatter=0.02,0.05 -o runs`` runs it with 500 seeds.
"""

from __future__ import annotations

import random

import set_the_table

import pycram
from pycram.bullet_world import BulletWorld

SCATTERED = ("milk", "cereal", "bowl")  # the spoon lies in a drawer, where there is no room


def scatter(distance: float) -> None:
    """Moves what stands on the counter by up to a distance, in m, along both of its sides."""
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
