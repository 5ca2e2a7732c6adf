"""Which grasps would hold an object: the hand gets there, touches nothing else, and has a finger on both sides.

Picking up takes the first to which a path is found; whoever looks for a place to stand asks for the first there.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import Blocked, DoesNotFit, GraspFailed, PlanFailure, Unreachable
from pycram.reasoning.choosing import Choice
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping import choice as grasp_choice, fingers
from pycram.reasoning.grasping.grasps import FREE, candidates, leaning
from pycram.reasoning.rejections import Misfit, Slips, Touching
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pycram.models.robots.description import Arm
    from pycram.reasoning.grasping.choice import GraspPlan
    from pycram.reasoning.grasping.fingers import Closing
    from pycram.reasoning.grasping.grasps import Grasp
    from pycram.reasoning.kinematics.arm import Posture
    from pycram.world.object import Object
    from recorder.geometry import Pose

_MAX_GRASPS: Final = 6  # that are tried, one after the other
_LEANING: Final = math.radians(5)  # that the message tells


def ways_to_hold(
    robot: Object,
    arm: Arm,
    body: Object,
    names: Sequence[str] | None,
    failures: list[PlanFailure],
    choice: Choice,
    base: Pose | None = None,
) -> Iterator[tuple[Grasp, Posture, Closing]]:
    """Yield grasps with the arm's posture and how the gripper closes then, the one that touches least first.

    Args:
        robot: the robot; its world's lock is held.
        arm: the arm.
        body: the object.
        names: the sides that are allowed; None for all.
        failures: gets why others won't do; the caller may add its own, and it ends after a few of either.
        choice: gets the same, by grasp.
        base: pose that the robot's base is taken to have; where it stands by default.
    """
    refused: list[Grasp] = []
    while len(failures) < _MAX_GRASPS:
        plan = grasp_choice.best(body, robot, arm.tool_frame, names, refused, choice, base)
        if plan.grasp is None or plan.posture is None:
            failures.append(_nothing(robot, arm, body, names, plan, base))
            return
        closing = fingers.closed_around(robot, arm, plan.posture.positions, body, base)
        failure = _problem(arm, body, plan, closing)
        if failure is not None:
            failures.append(failure)
            slips = Slips(closing.sides if closing else 0)
            choice.reject(str(plan.grasp), Touching(failure.pairs) if isinstance(failure, Blocked) else slips)
        elif closing is not None:
            yield plan.grasp, plan.posture, closing
        refused.append(plan.grasp)


def _nothing(
    robot: Object, arm: Arm, body: Object, names: Sequence[str] | None, plan: GraspPlan, base: Pose | None
) -> PlanFailure:
    """Return why no grasp was found."""
    if plan.posture is None:
        tilt = geometry.angle(leaning(body), geometry.IDENTITY[1])
        lies = f"as it leans, by {math.degrees(tilt):.0f} degrees, " if tilt > _LEANING else ""
        if arm.gripper.suction:
            return GraspFailed(arm.name, body.name, f"{lies}it is nowhere flat enough for the suction cup")
        sides = Choice("grasp", {})  # also where nobody records
        candidates(body, robot, arm, names, base=base, choice=sides)
        misfits = [reason for reason in sides.reasons() if isinstance(reason, Misfit)]
        widths = [misfit.width for misfit in misfits if misfit.width is not None]
        return DoesNotFit(arm.name, body.name, widths, arm.gripper.gap, arm.gripper.aperture - FREE, lies)
    if plan.self_collisions:
        return Blocked(arm.name, center(body), plan.self_collisions)
    return Unreachable(arm.name, center(body), plan.posture.position_error)


def _problem(arm: Arm, body: Object, plan: GraspPlan, closing: Closing | None) -> PlanFailure | None:
    """Return why a grasp doesn't do; None if it does."""
    if plan.obstacles:
        return Blocked(arm.name, center(body), [collision["pair"] for collision in plan.obstacles.values()])
    if plan.penetrating is not None:
        return Blocked(arm.name, center(body), [plan.penetrating])
    if closing is None:
        return GraspFailed(arm.name, body.name, "its fingers would close on nothing")
    if closing.obstacles:
        return Blocked(arm.name, center(body), closing.obstacles, "when the fingers close")
    if closing.sides < 2:
        return GraspFailed(arm.name, body.name, "its fingers would touch it on one side only")
    return None
