"""What the current robot's hands hold, and whether its arms are parked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import MissingPart, PlaceFailed, ReasoningError
from pycram.world import carried
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from pycram.models.robots.description import Arm
    from pycram.world.object import Object

_PARKED: Final = 0.01  # rad or m that a joint of a parked arm may be off


def arms() -> list[Arm]:
    """Return the arms of the current robot that can take something.

    Raises:
        MissingPart: It has none.
    """
    robot = BulletWorld.current_robot()
    found = [] if robot.description is None else [arm for arm in robot.description.arms.values() if arm.hand]
    if not found:
        raise MissingPart(robot.name, "arm with a gripper")
    return found


def held_by(arm: Arm) -> Object | None:
    """Return what an arm of the current robot holds; None for nothing."""
    return carried.attached_to(BulletWorld.current_robot(), arm.tool_frame)


def holder(body: Object) -> Arm | None:
    """Return the arm of the current robot that holds an object; None if none does."""
    return next((arm for arm in arms() if held_by(arm) is body), None)


def holding_arm(body: Object) -> Arm:
    """Return the arm of the current robot that holds an object, to be put down.

    Raises:
        PlaceFailed: None does.
    """
    arm = holder(body)
    if arm is None:
        raise PlaceFailed(body.name, body.get_position(), f"{BulletWorld.current_robot().name} doesn't hold it")
    return arm


def free_arms(name: str | None = None) -> list[str]:
    """Return the names of arms that hold nothing: of all, or of one that is wanted.

    Raises:
        MissingPart: The robot has no arm.
        ReasoningError: None is free.
    """
    wanted = [arm for arm in arms() if name is None or arm.name == name]
    found = [arm.name for arm in wanted if held_by(arm) is None]
    if not found:
        holding = ", ".join(f"the {arm.name} arm holds {held.name}" for arm in wanted if (held := held_by(arm)))
        raise ReasoningError(f"no arm is free: {holding or f'there is no {name} arm with a gripper'}")
    return found


def is_parked(arm: Arm) -> bool:
    """Whether an arm of the current robot is in its posture "park"."""
    robot = BulletWorld.current_robot()
    return all(abs(robot.get_joint_position(joint) - value) < _PARKED for joint, value in arm.posture("park").items())
