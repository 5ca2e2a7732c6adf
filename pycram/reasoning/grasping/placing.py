"""Putting objects down: the height at which an object rests, the arm's posture, and the hand's retreat."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import CollisionPair, NoPath, PlaceFailed
from pycram.reasoning.choosing import UNRECORDED, Choice
from pycram.reasoning.collision import checker
from pycram.reasoning.collision.checker import DEPTH, CollisionChecker, PostureCandidate
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping import fingers, grasps
from pycram.reasoning.kinematics import inverse
from pycram.reasoning.kinematics.inverse import Solver
from pycram.reasoning.rejections import NoRoom, OutOfReach, Touching
from recorder import geometry
from recorder.geometry import Pose, Quaternion, Vector
from recorder.records import STEPS_PER_SECOND
from recorder.records.text import link_text

if TYPE_CHECKING:
    from pycram.models.robots.description import Arm
    from pycram.world.object import Object

_ABOVE: Final = 0.05  # height in m by which the support may be above the target
_BELOW: Final = 0.10  # height in m by which the support may be below the target
_STEP: Final = 0.005  # distance in m between tried heights; a gripper also stops at thinner objects
_ACCURACY: Final = 2e-4  # accuracy in m of the resting height
_BACK: Final = (0.1, 0.15, 0.2)  # length of a hand's retreat in m; fingers are shorter
_OVERLAP: Final = 2e-4  # usual overlap in m of shapes at rest
_LIFTS: Final = (0.005, 0.01, 0.015)  # heights in m from which an object may be dropped
_MAX_LIFTED: Final = 4  # maximum number of poses from which an object may be dropped
_FROM_BELOW: Final = 0.5  # minimum upward component of a unit vector of a hand that comes from below
_UPSIDE_DOWN: Final = (1.0, 0.0, 0.0, 0.0)
_YAWS: Final = 12  # number of orientations about the vertical that are tried first; then the orientations between
_MOVED: Final = (0.01, math.radians(5))  # largest motion in m and rad of an object that stays
_LYING: Final = math.sin(math.radians(10))  # maximum upward component of the z axis of an object that lies on a side


def resting_position(body: Object, target: Sequence[float], orientation: Quaternion) -> Vector:
    """Return the target (xyz, m) at the height at which an object, on its way down, first touches something.

    Robots and their held objects don't support the object. PlaceFailed is raised without room or support.
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
    """Return the height at which an object on its way down first touches something; see :func:`resting_position`.

    ``touched`` returns the overlaps at a height in m; ``gap`` returns how far in m the object can sink from there.
    """
    z = target[2]
    high = z + _ABOVE
    blockers = still = touched(high)
    while still and high - _STEP >= z:  # an obstacle above the target, such as a shelf, may leave less room
        high -= _STEP
        still = touched(high)
    if still:
        there = [link_text(pair.body, pair.body_link) for pair in blockers]
        reason = f"{' and '.join(there)} {'is' if len(there) == 1 else 'are'} there already"
        raise PlaceFailed(body.name, target, reason, pairs=blockers)
    free = high - gap(high)

    def meets(height: float) -> bool:
        return height <= free and bool(touched(height))

    low = high
    while not meets(low):
        high, low = low, low - _STEP
        if low < z - _BELOW:
            raise PlaceFailed(body.name, target, f"there is no support within {_BELOW} m below")
    while high - low > _ACCURACY:
        half = (high + low) / 2
        if meets(half):
            low = half
        else:
            high = half
    return high


def retreat(robot: Object, arm: Arm, choice: Choice) -> Mapping[str, float] | None:
    """Return joint positions of an arm that draw its hand back from a released object; None if no retreat is free."""
    tool = arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame))
    for back in _BACK:
        name = f"{back:g} m back"
        if not choice.admits(name):
            continue
        for posture in inverse.postures(robot, arm.tool_frame, geometry.transform(tool, (-back, 0.0, 0.0)), tool[1]):
            if not posture.reaches():
                choice.reject(name, OutOfReach(posture.position_error, posture.turn_error))
                continue
            pairs = checker.in_the_way(robot, posture.positions)
            if not pairs:
                choice.take(name)
                return posture.positions
            choice.reject(name, Touching(pairs))
    for name in filter(choice.admits, arm.poses):
        pairs = checker.in_the_way(robot, arm.posture(name))
        if not pairs:
            choice.take(name)
            return arm.posture(name)
        choice.reject(name, Touching(pairs))
    return None


@dataclass(frozen=True, slots=True)
class Placement:
    """A way to put an object down."""

    name: str  # a unique name among the placements
    pose: Pose  # pose of the object at its release
    tool: Pose  # pose of the tool at the object's release
    posture: Mapping[str, float]  # joint positions of the arm by name
    opened: Mapping[str, float]  # joint positions of the open gripper by name


@dataclass(slots=True)
class Refusals:
    """The reasons against poses and postures for a placement."""

    no_room: list[PlaceFailed] = field(default_factory=list)  # failures at poses without room for the object
    misses: list[OutOfReach] = field(default_factory=list)  # distances between nearest postures and goals
    pairs: dict[str, CollisionPair] = field(default_factory=dict)  # links that would touch, by the object in the way
    low: list[Pose] = field(default_factory=list)  # poses in which the hand would touch the support of the object
    no_path: list[NoPath] = field(default_factory=list)  # failed searches for a path to a good posture


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
    """Yield ways in which an arm can put down its held object without a collision, also when the fingers open.

    The target is xyz in m; an orientation of None means upright with a natural yaw. ``rests`` has the resting positions
    by orientation, or why there is none; new results are added.
    """
    body_T_tool = geometry.multiply(
        geometry.invert(body.get_position_and_orientation()),
        arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame)),
    )
    hand = {arm.gripper.palm, *arm.gripper.fingers}
    solver = Solver(robot, arm.tool_frame)
    groups = _orientations(robot, body, body_T_tool, orientation, base, once=quickly)
    known = {} if rests is None else rests
    groups = itertools.takewhile(lambda _: refusals.misses or refusals.pairs or not refusals.no_room, groups)
    poses = (pose for turns in groups for pose in _poses(body, target, turns, refusals, choice, known))
    for pose, quick, lift in poses:
        if quickly and not quick:
            return
        name = _name(pose[1]) + (f", released {1e3 * lift:.0f} mm higher" if lift else "")
        if not choice.admits(name):
            continue
        tool = geometry.multiply(pose, body_T_tool)
        for posture in solver.search([(*tool, base)], quick=quick, thorough=not quick)[0]:
            if not posture.reaches():
                refusals.misses.append(OutOfReach(posture.position_error, posture.turn_error))
                choice.reject(name, refusals.misses[-1])
                continue
            with CollisionChecker(robot, posture.positions) as own:
                (candidate,) = own.predict([posture.positions], base)
                pairs = own.in_the_way(candidate) or _pressed(own, candidate, arm, body)
            if not pairs:
                opening = fingers.finger_motion(
                    robot, arm, 1.0, posture=posture.positions, release=body, pose=pose, base=base
                )
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


def lying(robot: Object, arm: Arm, body: Object, target: Sequence[float]) -> Quaternion | None:
    """Return an orientation in which an arm can lay an object on a side that is stable; None without one."""
    held = arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame))[1]
    tool_T_body = geometry.product(geometry.conjugate(held), body.get_orientation())
    for name in grasps.GRASPS:
        turn = geometry.product(grasps.grasp_orientation(name, robot), tool_T_body)
        upward = abs(geometry.rotate(turn, (0.0, 0.0, 1.0))[2])
        ways = placements(robot, arm, body, target, turn, Refusals(), UNRECORDED) if upward < _LYING else iter(())
        if any(_stays(body, way.pose) for way in itertools.islice(ways, 1)):
            return turn
    return None


def _stays(body: Object, pose: Pose) -> bool:
    """Return whether an object stays for 1 s where a hand releases the object; other held objects are left out."""
    world = body.world
    others = [other for other in world.objects if not (other.is_robot or other is body or other.carrier)]
    clone = clone_of(world, "physics")
    copies, _ = clone.sync([body, *others])
    try:
        clone.engine.set_pose(copies[body.name], pose)
        clone.engine.step(STEPS_PER_SECOND)
        position, turn = clone.engine.pose(copies[body.name])
    finally:
        clone.invalidate(*copies)
    return math.dist(position, pose[0]) <= _MOVED[0] and geometry.angle(turn, pose[1]) <= _MOVED[1]


def _pressed(checker: CollisionChecker, candidate: PostureCandidate, arm: Arm, body: Object) -> list[CollisionPair]:
    """Return the overlaps of the arm's links, except the hand, with the object: these links would push the object."""
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
    """Yield poses for putting an object down, whether the search is quick, and the height in m above the rest.

    After the quick searches, the same poses are searched thoroughly. If the hand would touch a narrow support, the last
    poses are a little higher, and the hand drops the object.
    """
    tried: list[Pose] = []
    for turn in turns:
        if turn not in rests:
            try:
                rests[turn] = resting_position(body, target, turn)
            except PlaceFailed as failure:
                rests[turn] = failure
        position = rests[turn]
        if isinstance(position, PlaceFailed):  # other orientations may have room
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
    """Return a unique name among the orientations of an object."""
    x, y, _ = geometry.rotate(turn, (1.0, 0.0, 0.0))
    upside_down = geometry.rotate(turn, (0.0, 0.0, 1.0))[2] < 0.0
    return f"yaw {math.degrees(math.atan2(y, x)):.0f}{' upside down' if upside_down else ''}"


def _orientations(
    robot: Object,
    body: Object,
    body_T_tool: Pose,
    orientation: Sequence[float] | None,
    base: Pose | None,
    *,
    once: bool,
) -> Iterator[Sequence[Quaternion]]:
    """Yield orientations in which an object may be put down, the most natural first, in one or two groups.

    If the hand would be below the upright object, the object may also be put down upside down.
    """
    if orientation is not None:
        x, y, z, w = orientation
        yield [(x, y, z, w)]
        return
    natural = [grasps.grasp_orientation(grasp, robot, base) for grasp in grasps.GRASPS]
    start = grasps.yaw(body)
    from_below = geometry.rotate(body_T_tool[1], (1.0, 0.0, 0.0))[2] > _FROM_BELOW

    def strain(turn: Quaternion) -> float:
        tool = geometry.product(turn, body_T_tool[1])
        return min(geometry.angle(tool, side) for side in natural)

    for first in (0.0,) if once else (0.0, 0.5):
        upright = [geometry.from_rpy(0.0, 0.0, start + 2 * math.pi * (first + i) / _YAWS) for i in range(_YAWS)]
        flipped = [geometry.product(turn, _UPSIDE_DOWN) for turn in upright] if from_below else []
        yield [*sorted(upright, key=strain), *sorted(flipped, key=strain)]
