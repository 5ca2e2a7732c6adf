"""A small plan of motions that take time: an arm picks up a carton, and is stopped on the way to where it would park.

``pycram run tests/replay/golden/motions/plan.py --motion continuous --seed 7 --log tests/replay/golden/motions/VERSION.mcap``

The arm has the links and joints of a UR5 with PyCRAM's gripper, but boxes for meshes, so that its recording stays small.
"""

from __future__ import annotations

from pathlib import Path

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import PlanFailure
from pycram.language import timeout
from pycram.process_module import ProcessModule

HERE = Path(__file__).parent


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(name.replace("_", "-"), value) for name, value in slots.items()]))


def main() -> None:
    world = BulletWorld(name="table")
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    milk = Object("milk", "milk", str(HERE.parent / "carton.stl"), [0.5, 0.15, 0.1])
    world.robot = Object("arm", "robot", str(HERE / "arm.urdf"))
    world.settle()
    with timeout(60, simulated=True):  # which looks at each thirtieth of a second: keyframes come within motions
        perform(type="pick-up", object=milk, arm="ur5")
    try:
        with timeout(0.4, simulated=True):
            perform(type="move-arm-joints", ur5_arm="park")
    except PlanFailure as failure:
        print(failure)


if __name__ == "__main__":
    main()
