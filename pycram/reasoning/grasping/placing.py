"""Setting an object down: the height at which it touches what is below, and the hand's way out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pycram.foundation.collision_pair import CollisionPair
from pycram.foundation.failures import PlaceFailed
from pycram.reasoning.collision import checker
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.kinematics import solver
from pycram.reasoning.rejections import OutOfReach, Touching
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pycram.models.robots.description import Arm
    from pycram.reasoning.choosing import Choice
    from pycram.world.object import Object
    from recorder.geometry import Quaternion, Vector

_ABOVE: Final = 0.05  # m by which the support may be higher than the target says
_BELOW: Final = 0.10  # m by which it may be lower
_STEP: Final = 0.005  # m between heights that are tried; thinner things than this are thick enough to stop a gripper
_ACCURACY: Final = 2e-4  # m
_BACK: Final = (0.1, 0.15, 0.2)  # m by which a hand is drawn back: fingers take in less
_OVERLAP: Final = 2e-4  # m that shapes at rest overlap anyway


def set_down(body: Object, target: Sequence[float], orientation: Quaternion) -> Vector:
    """Return the position at which an object rests.

    Args:
        body: the object; robots and what they hold don't count as support.
        target: xyz where it is wanted, m.
        orientation: xyzw there.

    Returns:
        The target with the height at which the object first touches something when it comes from above.

    Raises:
        PlaceFailed: there is no room, or nothing below that it could stand on.
    """
    world = body.world
    clone = clone_of(world, "reach")
    others = [other for other in world.objects if other is not body and not other.is_robot and other.carrier is None]
    clone.sync()
    copy, engine = clone.body(body.name), clone.engine
    x, y, z = target
    here_T_there = geometry.multiply(((x, y, z - _BELOW), orientation), geometry.invert(clone.state(body).pose))
    near = clone.overlapping(clone.boxes(body).placed(here_T_there).raised(_BELOW + _ABOVE), others)

    def touched(height: float) -> list[CollisionPair]:
        engine.set_pose(copy, ((x, y, height), orientation))
        deepest: dict[str, CollisionPair] = {}
        for (other, link), part in near.items():
            for point in engine.closest_points(copy, part):
                known = deepest.get(other.name)
                if point.distance < -(known.depth if known else _OVERLAP):
                    links = checker.link_name(body, point.link_a), checker.link_name(other, link or point.link_b)
                    deepest[other.name] = CollisionPair(body.name, links[0], other.name, links[1], -point.distance)
        return list(deepest.values())

    def gap(height: float) -> float:
        engine.set_pose(copy, ((x, y, height), orientation))
        points = (point for part in near.values() for point in engine.closest_points(copy, part, _ABOVE))
        return min((point.distance for point in points), default=_ABOVE)

    try:
        return x, y, _resting_height(body, target, touched, gap)
    finally:
        clone.invalidate(body.name)


def _resting_height(
    body: Object,
    target: Sequence[float],
    touched: Callable[[float], list[CollisionPair]],
    gap: Callable[[float], float],
) -> float:
    """Return the height at which an object that comes from above touches something; see :func:`set_down`.

    Args:
        body: the object.
        target: xyz where it is wanted, m.
        touched: gives what it would overlap at a height.
        gap: gives how far it is there from what it could meet, m: so far down nothing is in its way.
    """
    z = target[2]
    high = z + _ABOVE
    blockers = still = touched(high)
    while still and high - _STEP >= z:  # what hangs above may leave less room, as in a shelf
        high -= _STEP
        still = touched(high)
    if still:
        there = [f"{pair.body_link} of {pair.body}" if pair.body_link else pair.body for pair in blockers]
        reason = f"{' and '.join(there)} {'is' if len(there) == 1 else 'are'} there already"
        raise PlaceFailed(body.name, target, reason, pairs=blockers)
    free = high - gap(high)

    def meets(height: float) -> bool:
        return height <= free and bool(touched(height))

    low = high
    while not meets(low):
        high, low = low, low - _STEP
        if low < z - _BELOW:
            raise PlaceFailed(body.name, target, f"nothing is within {_BELOW} m below that it could stand on")
    while high - low > _ACCURACY:
        half = (high + low) / 2
        if meets(half):
            low = half
        else:
            high = half
    return high


def retreat(robot: Object, arm: Arm, choice: Choice) -> Mapping[str, float] | None:
    """Return joint values of an arm whose hand is drawn back out of what it has let go of; None if it can't be.

    Args:
        robot: the robot; its world's lock is held.
        arm: the arm.
        choice: takes the other ways, and why they won't do.
    """
    tool = arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame))
    for back in _BACK:
        name = f"{back:g} m back"
        position = geometry.transform(tool, (-back, 0.0, 0.0))
        for posture in solver.postures(robot, arm.tool_frame, position, tool[1]):
            if not posture.reaches():
                choice.reject(name, OutOfReach(posture.position_error, posture.turn_error))
                continue
            pairs = checker.in_the_way(robot, posture.positions)
            if not pairs:
                choice.take(name)
                return posture.positions
            choice.reject(name, Touching(pairs))
    for name in arm.poses:
        pairs = checker.in_the_way(robot, arm.posture(name))
        if not pairs:
            choice.take(name)
            return arm.posture(name)
        choice.reject(name, Touching(pairs))
    return None
