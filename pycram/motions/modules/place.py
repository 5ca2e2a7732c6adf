"""Putting an object down that a gripper holds, and looking at where it came to rest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pycram.foundation.collision_pair import CollisionPair
from pycram.foundation.failures import PlaceFailed, Unreachable
from pycram.motions.modules.simulated import SimulatedModule
from pycram.reasoning.collision import checker
from pycram.reasoning.grasping import fingers, placing, sides
from pycram.reasoning.kinematics import solver
from pycram.world import settling
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.models.robots.description import Arm
    from pycram.motions.designator import Designator
    from pycram.world.object import Object
    from recorder.geometry import Pose, Quaternion

_TIMEOUT: Final = 5.0  # s of simulated time within which all has to be at rest
_AWAY: Final = 0.02  # m from where it was let go
_TURNED: Final = math.radians(10)  # from the orientation that was asked for, or from upright
_TOUCHING: Final = 1e-3  # m of air that count as touching
_LEANING: Final = math.radians(1)  # by which it has moved towards a finger that it touches
_YAWS: Final = 12  # orientations about the vertical in which putting down is tried


@dataclass(frozen=True, slots=True)
class _Plan:
    """How an object is put down.

    Attributes:
        posture: joint values of the arm by name.
        pose: of the object when it is let go of.
        opened: joint values of the open gripper by name.
    """

    posture: Mapping[str, float]
    pose: Pose
    opened: Mapping[str, float]


class Place(SimulatedModule):
    """Puts a held object down on what is there: upright if no orientation is given.

    It has succeeded when everything that it set in motion is at rest again, and the object stands where it was let go.
    """

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        arm = self.description(robot).arm(solution["arm"])
        body: Object = solution["object"]
        target, orientation = solution["target"], solution.get("orientation")
        with robot.world.lock:
            held = robot.attachments.get(body)
            if held is None or held.carrier_link != arm.tool_frame:
                raise PlaceFailed(body.name, target, f"the {arm.name} gripper doesn't hold it")
            plan = _plan(robot, arm, body, target, orientation)
            restless = set(settling.moving(robot.world))
            robot.set_joint_positions(plan.posture)
            robot.set_joint_positions(plan.opened)
            robot.detach(body)
            settled = robot.world.settle(_TIMEOUT)
            moving = [] if settled else [other for other in settling.moving(robot.world) if other not in restless]
            _check_outcome(robot, body, target, plan.pose, orientation, moving)


def _plan(robot: Object, arm: Arm, body: Object, target: Sequence[float], orientation: Sequence[float] | None) -> _Plan:
    """Return the first posture in which nothing is in the way, not even when the fingers open.

    Raises:
        PlaceFailed: There is none.
        Unreachable: No posture brings the object there.
    """
    body_T_tool = geometry.multiply(
        geometry.invert(body.get_position_and_orientation()),
        arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame)),
    )
    misses: list[float] = []
    blockers: dict[str, CollisionPair] = {}

    def poses() -> Iterator[tuple[Pose, bool]]:  # all of them searched for quickly, then again thoroughly
        tried: list[Pose] = []
        for turn in _orientations(robot, body, body_T_tool, orientation):
            tried.append((placing.set_down(body, target, turn), turn))
            yield tried[-1], True
        yield from ((pose, False) for pose in tried)

    for pose, quick in poses():
        position, turn = geometry.multiply(pose, body_T_tool)
        for posture in solver.postures(robot, arm.tool_frame, position, turn, quick=quick):
            if not posture.reaches():
                misses.append(posture.position_error)
                continue
            touched = checker.touched(robot, posture.positions)
            pairs = [collision["pair"] for collision in touched.values()]
            if not pairs:
                opening = fingers.moved(robot, arm, 1.0, posture=posture.positions, release=body, pose=pose)
                if opening.gap >= fingers.CLEAR or not opening.stopped_by:
                    return _Plan(posture.positions, pose, opening.positions)
                pairs = list(opening.stopped_by)
            for pair in pairs:
                blockers.setdefault(pair.body, pair)
    if blockers:
        pairs = [blockers[name] for name in sorted(blockers)]
        raise PlaceFailed(body.name, target, "", orientation=orientation, pairs=pairs)
    raise Unreachable(arm.name, target, min(misses, default=None))


def _check_outcome(
    robot: Object,
    body: Object,
    target: Sequence[float],
    wanted: Pose,
    orientation: Sequence[float] | None,
    moving: Sequence[Object],
) -> None:
    """Raise PlaceFailed unless an object stands where it was let go.

    Args:
        robot: the robot that let it go.
        body: the object.
        target: where it was to be put.
        wanted: its pose when it was let go.
        orientation: that was asked for; None for upright.
        moving: what was set in motion and doesn't come to rest.
    """
    position, turn = body.get_position_and_orientation()
    away, turned = math.dist(position, wanted[0]), geometry.angle(turn, wanted[1])
    up, asked_up = (geometry.rotate(each, (0.0, 0.0, 1.0)) for each in (turn, wanted[1]))
    lean = math.acos(max(-1.0, min(1.0, sum(a * b for a, b in zip(up, asked_up, strict=True)))))
    touching = _touching(body)
    reasons = []
    if moving:
        names = ", ".join(other.name for other in moving)
        reasons.append(f"{names} still move{'s' if len(moving) == 1 else ''} after {_TIMEOUT:g} s")
    if away > _AWAY:
        reasons.append(f"it came to rest {away:.3f} m from there" if body not in moving else f"it is {away:.3f} m away")
    if lean > _TURNED:
        reasons.append(f"it leans by {math.degrees(lean):.0f} degrees")
    elif orientation is not None and turned > _TURNED:
        reasons.append(f"it is turned by {math.degrees(turned):.0f} degrees")
    elif lean > _LEANING and any(pair.body == robot.name for pair in touching):
        reasons.append("it leans on the gripper")
    if reasons:
        at = ", ".join(pair.body_link + " of " * bool(pair.body_link) + pair.body for pair in touching) or "nothing"
        reason = f"{', '.join(reasons)}; it touches {at}"
        raise PlaceFailed(
            body.name,
            target,
            reason,
            orientation=orientation,
            wanted=wanted,
            rest=(position, turn),
            touching=touching,
        )


def _touching(body: Object) -> list[CollisionPair]:
    """Return what an object touches, one pair of links an object."""
    world = body.world
    found = []
    for other in world.objects:
        points = [] if other is body else world.engine.closest_points(body.handle, other.handle, _TOUCHING)
        if points:
            nearest = min(points, key=lambda point: point.distance)
            links = (nearest.link_a if len(body.links) > 1 else "", nearest.link_b if len(other.links) > 1 else "")
            found.append(CollisionPair(body.name, links[0], other.name, links[1], max(0.0, -nearest.distance)))
    return found


def _orientations(
    robot: Object, body: Object, body_T_tool: Pose, orientation: Sequence[float] | None
) -> Iterator[Quaternion]:
    """Yield orientations in which an object may be put down, the most natural for the arm first."""
    if orientation is not None:
        x, y, z, w = orientation
        yield (x, y, z, w)
        return
    natural = [sides.grasp_orientation(grasp, robot) for grasp in sides.GRASPS]
    start = sides.yaw(body)
    upright = [geometry.from_rpy(0.0, 0.0, start + 2 * math.pi * i / _YAWS) for i in range(_YAWS)]

    def strain(turn: Quaternion) -> float:
        tool = geometry.product(turn, body_T_tool[1])
        return min(geometry.angle(tool, side) for side in natural)

    yield from sorted(upright, key=strain)
