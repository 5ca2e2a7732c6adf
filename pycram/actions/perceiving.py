"""Looking at an object again, where it is believed to be."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pycram.actions.action import action
from pycram.actions.objects import candidates_of
from pycram.actions.performing import perform
from pycram.foundation.failures import PerceptionError
from pycram.knowledge import beliefs
from pycram.motions.designator import MotionDesignator
from pycram.motions.modules.perception import RECOGNISABLE
from pycram.reasoning.queries.visibility import visible
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.world.object import Object


@action("perceiving")
def perceiving(object: Any) -> Object:  # noqa: A002  the slot's name
    """Turns the camera to where an object is believed to be, and detects it there; returns the object.

    Of what nothing is believed it is detected in what the camera sees now. A robot without a camera is told where it is
    by the state of the world. It fails with PerceptionError if the object isn't seen.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
    """
    bodies = candidates_of(object)
    known = next((belief for belief in beliefs() if belief.object in bodies), None)
    if known is not None and has_camera():
        perform(MotionDesignator(type="looking", target=known.position))
    return detected(bodies)


def has_camera() -> bool:
    """Return whether the robot has one, as its description says."""
    description = BulletWorld.current_robot().description
    return description is not None and description.camera is not None


def detected(bodies: Sequence[Object]) -> Object:
    """Return the one of some objects of a type that the robot's camera sees best, as it is directed now.

    Raises:
        PerceptionError: It sees none of them, or only others.
    """
    kind = bodies[0].type
    sees = has_camera()
    found: Object = perform(MotionDesignator(type="detecting" if sees else "world-state-detecting", object_type=kind))
    if found in bodies:
        return found
    robot = BulletWorld.current_robot()
    if sees and robot.description is not None and robot.description.camera is not None:
        for body in bodies:
            if visible(body, robot.description.camera.frame, robot=robot, threshold=RECOGNISABLE):
                return body
    raise PerceptionError(kind, {body.name: f"is not seen, but {found.name}" for body in bodies})
