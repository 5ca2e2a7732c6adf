"""A small plan whose recording holds what records lacked at first: ``pycram run tests/replay/golden/reasons/plan.py``.

Refusals, output, subscriptions, calls of handlers, decisions and choices with their candidates, local variables. The
robot is a cabinet with a process module of its own, so that the recording stays small.
"""

from __future__ import annotations

import logging
from pathlib import Path

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.event import Event
from pycram.failures import PlanFailure, UsageError
from pycram.process_module import ProcessModule, execution_environment, register
from pycram.reasoning.choosing import choosing
from pycram.reasoning.rejections import Misfit, OutOfReach

HERE = Path(__file__).parent.parent
CARTON = str(HERE / "carton.stl")


class Take(ProcessModule):
    def _execute(self, designator: MotionDesignator) -> None:
        body = designator.reference()["object"]
        with choosing("shelf", body.world, object=body) as choice:
            choice.reject("upper", OutOfReach(0.3))
            choice.reject("middle", OutOfReach(0.1))
            choice.reject("lower", Misfit(0.1, 0.0, 0.08))
            raise PlanFailure(f"{body.name} is on no shelf")


def take(designator: MotionDesignator) -> list[dict[str, object]] | None:
    return [{"cmd": "take", "object": designator.prop_value("object")}] if designator.type == "taking" else None


def main() -> None:
    world = BulletWorld(name="shop")
    Object("floor", "environment", "plane.urdf")
    milk = Object("milk", "milk", CARTON, [0, 0, 0.1])
    cereal = Object("cereal", "cereal", CARTON, [1, 0, 0.13])
    world.robot = Object("machine", "robot", str(HERE / "cabinet.urdf"), [2, 0, 0.5])

    def deliver(customer: str) -> None:
        cereal.set_position([1, 1, 0.13])
        print("cereal for", customer)

    bell = Event("bell", "door")
    bell += deliver
    bell.fire("Anna")
    bell -= deliver
    try:
        milk.set_position([1, float("nan"), 0.1])
    except UsageError:
        logging.getLogger("shop").warning("the milk stays")
    register("cabinet", "shop", {"take": Take()})
    with MotionDesignator.resolvers.added(take), execution_environment("shop"):
        ProcessModule.perform(MotionDesignator([("type", "taking"), ("object", milk)]))


if __name__ == "__main__":
    main()
