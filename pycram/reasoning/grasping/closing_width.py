"""The closing width: a gripper closes until a finger touches what is between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pycram.reasoning.collision.simulation_clone import clone_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pycram.models.robots.description import Gripper
    from pycram.world.object import Object

_SLACK: Final = 5e-4  # m of overlap that is a touch
_AT_CUP: Final = 0.004  # m from a suction cup that its lip bridges
_STEPS: Final = 8  # from open to closed, less than a finger's thickness each
_HALVINGS: Final = 5  # of such a step: 0.4 mm of the PR2's aperture


def closed_around(
    robot: Object, gripper: Gripper, posture: Mapping[str, float], body: Object
) -> dict[str, float] | None:
    """Return the joint values of a gripper that has closed on an object; a suction cup has none.

    Args:
        robot: the robot.
        gripper: its gripper.
        posture: joint values by name that bring it to the object.
        body: the object, which stays where it is.

    Returns:
        The values; None if nothing is between the fingers, or at the cup.
    """
    clone = clone_of(robot.world, "reach")
    bodies = clone.sync()
    engine, hand, target = clone.engine, bodies[robot.name], bodies[body.name]

    def touches(share: float) -> bool:
        engine.set_joints(hand, gripper.at(share))
        return any(
            touch.distance < -_SLACK
            for finger in gripper.fingers
            for touch in engine.link_closest_points(hand, finger, target)
        )

    try:
        engine.set_joints(hand, posture)
        if gripper.suction:
            near = engine.link_closest_points(hand, gripper.palm, target, _AT_CUP)
            return {} if near else None
        # a hollow thing may be touched on the way only: closed, the fingers would be within it
        tried = (step / _STEPS for step in reversed(range(_STEPS)))
        stuck = next((share for share in tried if touches(share)), None)
        if stuck is None:
            return None
        free = stuck + 1.0 / _STEPS
        for _ in range(_HALVINGS):
            share = (free + stuck) / 2
            if touches(share):
                stuck = share
            else:
                free = share
    finally:
        clone.invalidate(robot.name)
    return gripper.at(stuck)
