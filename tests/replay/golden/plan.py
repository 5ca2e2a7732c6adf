"""A small plan whose recording holds something of everything: ``pycram run tests/replay/golden/plan.py --log ...``.

A drawer is opened, a box of cereal carries a milk carton, both are asked about, two tasks fail, and the plan gives up.
It loads no robot, so that its recording stays small.
"""

from __future__ import annotations

from pathlib import Path

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.language import par
from recorder.tracing.span import span

HERE = Path(__file__).parent
CARTON = str(HERE / "carton.stl")


def put(body: Object, height: float) -> None:
    with span("motion", "put", {"object": body, "height": height}):
        body.set_position([0, 0, height])
        if not btr.stable(body):
            raise btr.ReasoningError(f"{body.name} would fall from {height} m")


def main() -> None:
    world = BulletWorld(name="table")
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    milk = Object("milk", "milk", CARTON, [0, 0, 0.1])
    cereal = Object("cereal", "cereal", CARTON, [0.3, 0, 0.13])
    cabinet = Object("cabinet", "environment", str(HERE / "cabinet.urdf"), [2, 0, 0.5])
    world.simulate(0.2)
    opened = Fluent(False, "opened")
    cabinet.set_joint_position("drawer_joint", 0.25)
    opened.set_value(True)
    with span("motion", "carry", {"object": milk}):
        cereal.attach(milk)
        cereal.set_position([0.5, 0.2, 0.13])
        cereal.detach(milk)
    with par as block:
        block(btr.contact, milk, cereal)
        block(btr.visible, milk, [1.5, 0, 0.5])
    for turn in range(110):  # past a keyframe
        cereal.set_position([0.5 + turn / 1000, 0.2, 0.13])
    last: PlanFailure | None = None
    for height in (1.0, 0.5):
        try:
            put(milk, height)
        except PlanFailure as failure:
            last = failure
    raise btr.ReasoningError("the milk can't be put anywhere") from last


if __name__ == "__main__":
    main()
