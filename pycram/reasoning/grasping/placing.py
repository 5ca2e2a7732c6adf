"""Setting an object down: the height at which it touches what is below, and the hand's way out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import CollisionPair, PlaceFailed
from pycram.reasoning.collision import checker
from pycram.reasoning.collision.checker import DEPTH, CollisionChecker
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping import fingers, grasps
from pycram.reasoning.kinematics import inverse
from pycram.reasoning.kinematics.inverse import Solver
from pycram.reasoning.rejections import NoRoom, OutOfReach, Touching
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from pycram.foundation.failures import NoPath
    from pycram.models.robots.description import Arm
    from pycram.reasoning.choosing import Choice
    from pycram.reasoning.collision.checker import Candidate
    from pycram.world.object import Object
    from recorder.geometry import Pose, Quaternion, Vector


_ABOVE: Final = 0.05  # m by which the support may be higher than the target says
_BELOW: Final = 0.10  # m by which it may be lower
_STEP: Final = 0.005  # m between heights that are tried; thinner things than this are thick enough to stop a gripper
_ACCURACY: Final = 2e-4  # m
_BACK: Final = (0.1, 0.15, 0.2)  # m by which a hand is drawn back: fingers take in less
_OVERLAP: Final = 2e-4  # m that shapes at rest overlap anyway
_LIFTS: Final = (0.005, 0.01, 0.015)  # m from which something may fall
_MAX_LIFTED: Final = 4  # poses that are tried so
_FROM_BELOW: Final = 0.5  # of a unit vector pointing up, in which the hand would come
_UPSIDE_DOWN: Final = (1.0, 0.0, 0.0, 0.0)
_YAWS: Final = 12  # orientations about the vertical in which putting down is tried


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
        choice: takes the other ways, and why they won't do.
    """
    tool = arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame))
    for back in _BACK:
        name = f"{back:g} m back"
        position = geometry.transform(tool, (-back, 0.0, 0.0))
        for posture in inverse.postures(robot, arm.tool_frame, position, tool[1]):
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


@dataclass(frozen=True, slots=True)
class Placement:
    """How an object can be put down."""

    name: str  # what tells it from others
    pose: Pose  # of the object when it is let go of
    tool: Pose  # pose of the tool then
    posture: Mapping[str, float]  # joint values of the arm by name
    opened: Mapping[str, float]  # those of the open gripper


@dataclass(slots=True)
class Refusals:
    """Why poses and postures won't do."""

    no_room: list[PlaceFailed] = field(default_factory=list)  # there is none for the object
    misses: list[float] = field(default_factory=list)  # m that the nearest posture stays away
    # links that would meet, by the name of what is in the way
    pairs: dict[str, CollisionPair] = field(default_factory=dict)
    low: list[Pose] = field(default_factory=list)  # poses in which the hand would meet what the object is put on
    no_path: list[NoPath] = field(default_factory=list)  # searches for a path to a posture that would do


def placements(
    robot: Object,
    arm: Arm,
    body: Object,
    target: Sequence[float],
    orientation: Sequence[float] | None,
    refusals: Refusals,
    choice: Choice,
    base: Pose | None = None,
    *,
    quickly: bool = False,
    rests: dict[Quaternion, Vector | PlaceFailed] | None = None,
) -> Iterator[Placement]:
    """Yield how the arm that holds an object can put it down with nothing in the way, not even when the fingers open.

    Args:
        robot: the robot; its world's lock is held.
        target: xyz in m.
        orientation: xyzw; None for upright.
        refusals: gets why other poses and postures won't do.
        choice: gets the same, by pose.
        base: pose that the robot's base is taken to have; where it stands by default.
        quickly: don't look long; that nothing is found then proves nothing.
        rests: where the object rests at the target, by orientation, or why it doesn't, as far as it is known; it gets
            what is found.
    """
    body_T_tool = geometry.multiply(
        geometry.invert(body.get_position_and_orientation()),
        arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame)),
    )
    hand = {arm.gripper.palm, *arm.gripper.fingers}
    solver = Solver(robot, arm.tool_frame)
    turns = _orientations(robot, body, body_T_tool, orientation, base)
    known = {} if rests is None else rests
    for pose, quick, lift in _poses(body, target, turns, refusals, choice, known):
        if quickly and not quick:
            return
        name = _name(pose[1]) + (f", let go {1e3 * lift:.0f} mm higher" if lift else "")
        tool = geometry.multiply(pose, body_T_tool)
        for posture in solver.search([(*tool, base)], quick=quick, thorough=not quick)[0]:
            if not posture.reaches():
                refusals.misses.append(posture.position_error)
                choice.reject(name, OutOfReach(posture.position_error, posture.turn_error))
                continue
            with CollisionChecker(robot, posture.positions) as own:
                (candidate,) = own.predict([posture.positions], base)
                pairs = own.in_the_way(candidate) or _pressed(own, candidate, arm, body)
            if not pairs:
                opening = fingers.moved(robot, arm, 1.0, posture=posture.positions, release=body, pose=pose, base=base)
                if opening.gap >= fingers.CLEAR or not opening.stopped_by:
                    yield Placement(name, pose, tool, posture.positions, opening.positions)
                    continue
                pairs = list(opening.stopped_by)
            elif (
                quick
                and not lift
                and all(pair.link in hand and robot.world.get_object(pair.body).is_environment for pair in pairs)
            ):
                refusals.low.append(pose)
            choice.reject(name, Touching(pairs))
            for pair in pairs:
                refusals.pairs.setdefault(pair.body, pair)


def _pressed(checker: CollisionChecker, candidate: Candidate, arm: Arm, body: Object) -> list[CollisionPair]:
    """Return which links of the arm, but the hand's, would push away what is let go of: a wrist and what it holds meet.

    While it is held that counts for nothing, as it doesn't for other links that are next to each other.
    """
    robot = checker.robot
    points = checker.closest_points(candidate, clone_of(robot.world, "reach").body(body.name))
    hand = checker.links_beyond(arm.joints)
    depths: dict[str, float] = {}
    for point in points:
        if point.link_a not in hand and point.distance <= -DEPTH:
            depths[point.link_a] = max(depths.get(point.link_a, 0.0), -point.distance)
    return [
        CollisionPair(body.name, "", robot.name, link, depth, arm.name)
        for link, depth in sorted(depths.items(), key=lambda each: -each[1])
    ]


def _poses(
    body: Object,
    target: Sequence[float],
    turns: Iterable[Quaternion],
    refusals: Refusals,
    choice: Choice,
    rests: dict[Quaternion, Vector | PlaceFailed],
) -> Iterator[tuple[Pose, bool, float]]:
    """Yield poses in which an object may be put down, to be searched for quickly; then all again, thoroughly.

    Last come those in which only the hand would meet what is below, a little higher: what sticks out on both sides of
    something narrow may hang lower there than where the fingers are.

    Yields:
        The pose, whether to search quickly, and by how much it is higher than where the object touches something, m.
    """
    tried: list[Pose] = []
    for turn in turns:
        if turn not in rests:
            try:
                rests[turn] = set_down(body, target, turn)
            except PlaceFailed as failure:
                rests[turn] = failure
        position = rests[turn]
        if isinstance(position, PlaceFailed):  # there may be room for it when it is turned
            refusals.no_room.append(position)
            choice.reject(_name(turn), NoRoom(position.reason))
            continue
        tried.append((position, turn))
        yield tried[-1], True, 0.0
    yield from ((pose, False, 0.0) for pose in tried)
    for lift in _LIFTS:
        for (x, y, z), turn in refusals.low[:_MAX_LIFTED]:
            yield ((x, y, z + lift), turn), True, lift


def _name(turn: Quaternion) -> str:
    """Return what distinguishes an orientation from others in which an object may stand."""
    x, y, _ = geometry.rotate(turn, (1.0, 0.0, 0.0))
    upside_down = geometry.rotate(turn, (0.0, 0.0, 1.0))[2] < 0.0
    return f"yaw {math.degrees(math.atan2(y, x)):.0f}{' upside down' if upside_down else ''}"


def _orientations(
    robot: Object, body: Object, body_T_tool: Pose, orientation: Sequence[float] | None, base: Pose | None
) -> Iterator[Quaternion]:
    """Yield orientations in which an object may be put down, the most natural for the arm first.

    What was taken when it lay upside down would need a hand from below to be put down upright: it may lie as it lay.
    """
    if orientation is not None:
        x, y, z, w = orientation
        yield (x, y, z, w)
        return
    natural = [grasps.grasp_orientation(grasp, robot, base) for grasp in grasps.GRASPS]
    start = grasps.yaw(body)
    upright = [geometry.from_rpy(0.0, 0.0, start + 2 * math.pi * i / _YAWS) for i in range(_YAWS)]
    from_below = geometry.rotate(body_T_tool[1], (1.0, 0.0, 0.0))[2] > _FROM_BELOW

    def strain(turn: Quaternion) -> float:
        tool = geometry.product(turn, body_T_tool[1])
        return min(geometry.angle(tool, side) for side in natural)

    yield from sorted(upright, key=strain)
    if from_below:
        flipped = [geometry.product(turn, _UPSIDE_DOWN) for turn in upright]
        yield from sorted(flipped, key=strain)
