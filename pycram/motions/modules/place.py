"""The process module that puts down an object, and checks where the object comes to rest."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Final

from pycram.foundation.failures import (
    CollisionPair,
    MissingPart,
    NoPath,
    PlaceFailed,
    PlanFailure,
    PostureInCollision,
    Unreachable,
    phrases,
)
from pycram.models.robots.description import Arm
from pycram.motions.designator import Designator
from pycram.motions.execution import TIMEOUT, Step, most_patient, with_patience
from pycram.motions.process_module import FOLLOWING, SimulatedModule
from pycram.reasoning.choosing import Choice, choosing
from pycram.reasoning.collision import checker
from pycram.reasoning.grasping import placing
from pycram.reasoning.grasping.placing import Placement, Refusals, placements
from pycram.reasoning.rejections import OutOfReach, Unreached, short
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.overlaps import sunk
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import Pose, PoseLike
from recorder.records.text import link_text

_AWAY: Final = 0.02  # maximum distance in m between the object at rest and the place of its release
_TURNED: Final = math.radians(10)  # maximum turn of the object from the given orientation, or from upright
_FALL: Final = 0.1  # distance in m by which a neighbour must drop to count as fallen
_SKEW: Final = math.radians(1)  # minimum turn of an object that a message mentions
_TOUCHING: Final = 1e-3  # maximum gap in m between touching objects
_LOAD: Final = 0.01  # share of an object's weight above which it leans on the hand that it rests on
_ABOVE: Final = (0.0, 0.0, 1.0)  # direction from which the object is lowered


class Place(SimulatedModule):
    """Puts a held object down on a support; without a given orientation, the object is upright.

    The object rests on the first support on its way down, such as the bottom of a pot, at most 5 cm above and 10 cm
    below the target. Without support or room, PlaceFailed is raised before anything moves.

    The motion succeeds if all objects come to rest, the object stands where the hand released it, and neither its
    neighbours nor objects on the robot have moved. If the object leans on the hand, the hand moves back, and the object
    must still stand.
    """

    failures = (PlaceFailed, Unreachable, MissingPart)
    failures_in_time = (NoPath, PostureInCollision, *FOLLOWING)

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = BulletWorld.current_robot()
        arm = self.description(robot).arm(solution["arm"])
        body: Object = solution["object"]
        target, orientation = solution["target"], solution.get("orientation")
        with self.execution.whole(robot.world):
            with robot.world.lock:
                self._check_holds(robot, arm, body, target)
                _check_sunk(body, target)
                free = [other for other in robot.world.objects if not (other.fixed or other.is_robot)]
                lying = _poses(robot, [other for other in free if other.carrier is None])
                with choosing(
                    "placement", robot.world, object=body, arm=arm.name, target=target, orientation=orientation
                ) as choice:

                    def lower(posture: Mapping[str, float], tool: Pose, patience: float) -> Step:
                        above = geometry.rotate(geometry.invert(tool)[1], _ABOVE)
                        return self.execution.approach(robot, arm, posture, above, patience=patience)

                    lowering, placement = _plan(robot, arm, body, target, orientation, lower, choice)
            lowering()
            with robot.world.lock:
                self._check_holds(robot, arm, body, target)
                release = self.execution.grip(robot, placement.opened)
            release()
            with robot.world.lock:
                attachment.detach(robot, body)
                free = [other for other in robot.world.objects if not (other.fixed or other.is_robot)]
                lying = {other: pose for other, pose in lying.items() if other.alive}
                neighbours = {**_poses(body, free), **lying}
            restless = self.execution.settle(robot.world)
            reasons = _reasons(body, target, placement.pose, orientation, neighbours, restless)
            if not reasons:
                with robot.world.lock:
                    leans = _load(robot, body) > _LOAD
                    retreat = self._retreat(robot, arm, body) if leans else self.execution.retreat(robot, arm)
                if retreat is not None:
                    retreat()
                    restless = self.execution.settle(robot.world)
                    reasons = _reasons(body, target, placement.pose, orientation, neighbours, restless)
                elif leans:
                    reasons = ["the object leans on the gripper, which can't be drawn back"]
            if reasons:
                raise _failure(body, target, placement.pose, orientation, reasons)

    def _check_holds(self, robot: Object, arm: Arm, body: Object, target: Sequence[float]) -> None:
        if self.held(robot, arm) is not body:
            raise PlaceFailed(body.name, target, f"the {arm.name} gripper doesn't hold it")

    def _retreat(self, robot: Object, arm: Arm, body: Object) -> Step | None:
        """Return the step that draws the hand back from an object that leans on it; None if there is no way back."""
        with choosing("retreat", robot.world, object=body, arm=arm.name) as choice:
            posture = placing.retreat(robot, arm, choice)
        return None if posture is None else self.execution.move(robot, posture)


def _check_sunk(body: Object, target: Sequence[float]) -> None:
    """Check that no object is inside of furniture: the engine would throw this object during the placement."""
    for other, overlap, _ in sunk(body.world):
        inside = f"{other.name} is {overlap.depth * 1e3:.0f} mm inside of {overlap.body}"
        raise PlaceFailed(body.name, target, f"{inside}, which would throw it; world.settle() lifts it out")


def _plan(
    robot: Object,
    arm: Arm,
    body: Object,
    target: Sequence[float],
    orientation: Sequence[float] | None,
    lower: Callable[[Mapping[str, float], Pose, float], Step],
    choice: Choice,
) -> tuple[Step, Placement]:
    """Return the step to the first placement that the arm reaches without a collision, and this placement."""
    refusals = Refusals()
    for placement, patience in with_patience(placements(robot, arm, body, target, orientation, refusals, choice)):
        try:
            step = lower(placement.posture, placement.tool, patience)
        except NoPath as no_path:
            choice.reject(placement.name, Unreached(no_path.checks, no_path.distance, no_path.pairs))
            refusals.no_path.append(no_path)
        else:
            position, turn = placement.pose
            choice.take(placement.name, position=short(position), orientation=short(turn))
            return step, placement
    raise _refused(robot, arm, body, target, orientation, refusals)


def _refused(
    robot: Object,
    arm: Arm,
    body: Object,
    target: Sequence[float],
    orientation: Sequence[float] | None,
    refusals: Refusals,
) -> PlanFailure:
    if refusals.no_path:
        return most_patient(refusals.no_path)
    if not (refusals.pairs or refusals.misses):
        taken = refusals.no_room[0]
        pairs = [replace(pair, gripper=arm.name) for pair in taken.pairs]
        return PlaceFailed(body.name, target, taken.reason, orientation=orientation, pairs=pairs)
    lying = placing.lying(robot, arm, body, target) if orientation is None else None
    values = ", ".join(f"{round(part, 4) + 0.0:.4f}" for part in lying or ())
    remedy = f"; orientation=[{values}] puts it down lying" if lying else ""
    if refusals.pairs:
        pairs = [refusals.pairs[name] for name in sorted(refusals.pairs)]
        return PlaceFailed(body.name, target, f"{phrases(pairs)}{remedy}", orientation=orientation, pairs=pairs)
    miss = min(refusals.misses, key=OutOfReach.miss)
    turned = f"turned there by {math.degrees(miss.turn):.0f} degrees" if miss.turn > _SKEW else ""
    return Unreachable(arm.name, target, miss.distance, f"{turned}{remedy}".removeprefix("; "))


def _reasons(
    body: Object,
    target: Sequence[float],
    wanted: Pose,
    orientation: Sequence[float] | None,
    neighbours: Mapping[Object, PoseLike],
    restless: Collection[Object],
) -> list[str]:
    """Return why a placement failed, if it did; ``wanted`` is the object's pose at its release."""
    position, turn = body.get_position_and_orientation()
    away = min(math.dist(position, wanted[0]), math.dist(position, target))  # the object may slide to the target
    turned = geometry.angle(turn, wanted[1])
    lean = geometry.lean(turn, wanted[1])
    near = {body.name, *(pair.body for pair in _touching(body, body.world.objects))} if restless else set()
    moving = [other.name for other in restless if other.name in near]
    reasons = []
    if moving:
        reasons.append(f"{', '.join(moving)} still move{'s' if len(moving) == 1 else ''} after {TIMEOUT} s")
    if away > _AWAY:
        reasons.append(f"it {'is' if moving else 'came to rest'} {away:.3f} m from there")
    if lean > _TURNED:
        reasons.append(f"it leans by {math.degrees(lean):.0f} degrees")
    elif orientation is not None and turned > _TURNED:
        reasons.append(f"it is turned by {math.degrees(turned):.0f} degrees")
    return reasons + _pushed(neighbours)


def _failure(
    body: Object, target: Sequence[float], wanted: Pose, orientation: Sequence[float] | None, reasons: Sequence[str]
) -> PlaceFailed:
    touching = _touching(body, body.world.objects)
    at = ", ".join(link_text(pair.body, pair.body_link) for pair in touching) or "nothing"
    passed = [link_text(pair.body, pair.body_link) for pair in touching if _is_passed(body, pair, target)]
    at += f"; the target is beyond the edge of {passed[0]}" if passed else ""
    reason, rest = f"{', '.join(reasons)}; it touches {at}", body.get_position_and_orientation()
    return PlaceFailed(body.name, target, reason, orientation=orientation, wanted=wanted, rest=rest, touching=touching)


def _is_passed(body: Object, pair: CollisionPair, target: Sequence[float]) -> bool:
    """Return whether a target is higher than the furniture's link that an object touches, but not above this link."""
    other = body.world.get_object(pair.body)
    low, high = other.get_AABB(pair.body_link or None)
    return other.is_environment and high[2] < target[2] and not all(low[i] < target[i] < high[i] for i in (0, 1))


def _pushed(neighbours: Mapping[Object, PoseLike]) -> list[str]:
    """Return a reason for the failure for each neighbour that moved."""
    found = []
    for other, (position, turn) in neighbours.items():
        now, turned = other.get_position_and_orientation()
        away, angle = math.dist(now, position), math.degrees(geometry.angle(turned, turn))
        if away > _AWAY or angle > math.degrees(_TURNED):
            fell = position[2] - now[2]
            pushed = f"it pushed {other.name} by {away:.3f} m and {angle:.0f} degrees"
            found.append(f"{other.name} fell by {fell:.3f} m" if fell > _FALL else pushed)
    return found


def _poses(body: Object, others: Sequence[Object]) -> dict[Object, PoseLike]:
    """Return the poses of the objects that an object touches."""
    touched = [body.world.get_object(pair.body) for pair in _touching(body, others)]
    return {other: other.get_position_and_orientation() for other in touched}


def _load(robot: Object, body: Object) -> float:
    """Return the share of an object's weight that a robot bears."""
    engine = body.world.engine
    force = sum(contact.force for contact in engine.contacts(body.handle) if contact.other == robot.handle.id)
    weight = engine.center_of_mass(body.handle)[1] * math.hypot(*body.world.gravity) if force else 0.0
    return force / weight if weight else 0.0


def _touching(body: Object, others: Iterable[Object]) -> list[CollisionPair]:
    """Return the contacts of an object with other objects: one pair of links for each object."""
    engine = body.world.engine
    found = []
    for other in others:
        points = [] if other is body else engine.closest_points(body.handle, other.handle, _TOUCHING)
        if points:
            nearest = min(points, key=lambda point: point.distance)
            own, met = checker.link_name(body, nearest.link_a), checker.link_name(other, nearest.link_b)
            found.append(CollisionPair(body.name, own, other.name, met, max(0.0, -nearest.distance)))
    return found
