"""A program that begins its recording itself: ``python tests/replay/golden/motions/program.py RECORDING``, in a checkout."""

from __future__ import annotations

import sys
from pathlib import Path

import recorder
from pycram.bullet_world import BulletWorld, Object

CARTON = str(Path(__file__).parent.parent / "carton.stl")

if __name__ == "__main__":
    with recorder.record(sys.argv[1]), BulletWorld(name="table") as world:
        Object("milk", "milk", CARTON, [0, 0, 0.1])
        world.simulate(0.1)
