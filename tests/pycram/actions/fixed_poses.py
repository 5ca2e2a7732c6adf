"""Things carried to the island as ``demos/set_the_table.py`` does it: each place to stand, each arm and goal is given."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from pycram import bullet_world_reasoning as btr
from pycram.designator import MotionDesignator
from pycram.failures import PlanFailure
from pycram.process_module import ProcessModule
from recorder import geometry
from tests.random_kitchens import size

if TYPE_CHECKING:
    from pycram.bullet_world import Object
    from tests.random_kitchens import Scene

    Pose = tuple[tuple[float, float, float], float]

COUNTER: Final[Pose] = ((0.65, 0.7, 0.0), 0.0)
ISLAND: Final[Pose] = ((-0.3, 1.0, 0.0), math.pi)
#: Where the robot stands to take what is on or in something: position in m, heading in rad.
STANDING: Final[dict[str, Pose]] = {
    "counter": COUNTER,
    "upper sink drawer": COUNTER,  # as the spoon's
    "middle sink drawer": COUNTER,
    "table": ((-1.4, -0.22, 0.0), -math.pi / 2),
    "upper oven drawer": ((0.6, 1.9, 0.0), 0.0),
    "lower board": ((0.55, 2.0, 0.0), 0.0),
    "board": ((0.55, 2.0, 0.0), 0.0),
    "low shelf": ((0.6, -0.8, 0.0), -0.3),
    "middle shelf": ((0.6, -0.8, 0.0), -0.3),
    "left island drawer": ((0.05, 0.9, 0.0), math.pi),
    "middle island drawer": ((0.05, 1.7, 0.0), math.pi),
}
_TOP: Final = 0.851  # m
#: Where on the island each goes, x and y in m, and with which arm: the demo's, and the like of it.
GOALS: Final = {
    "milk": (-0.8, 1.0, "left"),
    "bowl": (-0.8, 1.2, "right"),
    "breakfast_cereal": (-1.0, 1.0, "right"),
    "spoon": (-0.8, 1.2, "right"),
    "bottle": (-0.8, 1.0, "left"),
    "cup": (-0.8, 1.0, "left"),
    "glass": (-0.8, 1.0, "left"),
    "apple": (-0.8, 1.2, "right"),
    "fork": (-0.8, 1.2, "right"),
    "knife": (-0.8, 1.2, "right"),
    "plate": (-0.8, 1.2, "right"),
    "pot": (-0.8, 1.2, "right"),
}


def carry(scene: Scene) -> None:
    """Carry the thing to the island."""
    opens = scene.spot.joint
    if opens and scene.kitchen.get_joint_position(opens) < 0.8 * scene.spot.open:
        _go(scene, STANDING[scene.drawing.thing.spot])
        handle = opens.removesuffix("_main_joint").removesuffix("_joint") + "_handle"
        what = {"drawer_joint": opens, "drawer_handle": handle, "part_of": scene.kitchen}
        _perform(type="accessing", **what, arm="left", distance=0.3 if "drawer" in opens else scene.spot.open)
        _park(scene)
    _move(scene, scene.thing, STANDING[scene.drawing.thing.spot], ())


def _move(scene: Scene, body: Object, standing: Pose, waiting: tuple[Object, ...]) -> None:
    """As the demo's ``move_object``: what blocks goes first."""
    x, y, arm = GOALS[body.type]
    _go(scene, standing)
    _perform(type="looking", object=body)
    _perform(type="detecting", object=body.type)
    gripper = scene.robot.description.arm(arm).tool_frame
    blocking = [other for other in btr.blocking(body, scene.robot, gripper) if other.type != "environment"]
    if blocking:
        if blocking[0] in (*waiting, body):
            raise btr.ReasoningError(f"{body.name} and {blocking[0].name} block each other")
        _move(scene, blocking[0], standing, (*waiting, body))
        _go(scene, standing)
    _perform(type="pick-up", object=body, arm=arm)
    _go(scene, ISLAND)
    _perform(type="place", object=body, target=[x, y, _TOP + size(body.type)[2] / 2 + 0.003], arm=arm)
    _park(scene)


def _go(scene: Scene, pose: Pose) -> None:
    _park(scene)
    position, yaw = pose
    _perform(type="moving", target=list(position), orientation=list(geometry.from_rpy(0, 0, yaw)))


def _park(scene: Scene) -> None:
    with suppress(PlanFailure):
        _perform(type="move-arm-joints", **{f"{arm}_arm": "park" for arm in scene.robot.description.arms})


def _perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))
