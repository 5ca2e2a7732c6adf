"""What would be in a robot's way if it reached for an object (thesis 4.4.6)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pycram.reasoning.choosing import considering
from pycram.reasoning.grasping import choice
from pycram.reasoning.grasping.sides import grasp_orientation
from pycram.reasoning.queries.query import Found, query

if TYPE_CHECKING:
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld


@query
def blocking(
    object: Object,
    robot: Object,
    gripper_name: str,
    world: BulletWorld | None = None,
    *,
    grasp: str | None = None,
) -> Found[Object]:
    """Return what a robot would touch if it reached for an object (thesis 4.4.6).

    Of the postures that reach, the one that touches least counts: a plan would take that one.

    Args:
        object: the object.
        robot: the robot.
        gripper_name: the link, mostly a tool frame.
        world: their world.
        grasp: "front", "top", "left" or "right"; by default the one that touches least.

    Returns:
        The objects in the way, deepest first, without the target and what the robot holds, and without the floor it
        stands on; the environment has the type "environment". Empty if it can't be reached at all, which the
        evidence says.

    Raises:
        UnknownName: another grasp, or a link that the robot doesn't have.
    """
    if grasp is not None:
        grasp_orientation(grasp, robot)  # refuses unknown ones
    considered = considering()
    plan = choice.best(object, robot, gripper_name, None if grasp is None else (grasp,), choice=considered)
    if plan.grasp is not None:
        considered.take(str(plan.grasp))
    return Found(plan.obstacles, plan.evidence(), considered=considered)
