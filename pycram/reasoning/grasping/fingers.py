"""Motions of fingers until an obstacle stops the fingers, computed in a simulation clone before the fingers move."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from pycram.foundation.failures import CollisionPair
from pycram.models.store import stored_tree
from pycram.physics.body import LoadedBody
from pycram.physics.engine import Engine
from pycram.reasoning.collision.boxes import Boxes
from pycram.reasoning.collision.checker import DEPTH, link_name
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.world.joints import coupled
from recorder import geometry
from recorder.geometry import Pose

if TYPE_CHECKING:
    from pycram.models.robots.description import Arm, Gripper
    from pycram.reasoning.collision.simulation_clone import Part, PosingClone
    from pycram.world.object import Object

    Depths: TypeAlias = Mapping[tuple[str, Object, str], float]  # depths in m, by finger, object and the object's link

CLEAR: Final = 0.002  # necessary gap in m around a released object; the engine pads shapes by a smaller amount
_SLACK: Final = 5e-4  # minimum overlap in m of links that touch
_STEPS: Final = 16  # steps between open and closed; fingers of the PR2 move by up to 3 mm in a step
_HALVINGS: Final = 6  # number of bisections of the step in which an obstacle stops the fingers
_AT_CUP: Final = 0.004  # gap in m that the lip of a suction cup bridges
_CLOSING_STEPS: Final = 8  # steps from open to closed, each less than the thickness of a finger
_CLOSING_HALVINGS: Final = 5  # number of bisections of a closing step: accurate to 0.4 mm of the PR2's aperture
_MANY: Final = 3  # minimum number of moving parts of a hand that close one by one; two jaws are one mechanism
_ALONE: Final = 64  # steps between open and closed for a part that closes alone
_REACH: Final = 0.005  # total gap in m between an object and opposite fingers that closes as hand and object give way
_ACROSS: Final = 0.5  # minimum component of a contact's unit normal along the jaws' direction
_AROUND: Final = 0.4  # the same for fingers around a center; two of three fingers touch a carton's edges at 60 degrees
_CACHED: Final = 32
_SWEPT: Final = 8  # steps between open and closed; within a step, fingers stay within the margins of their boxes


@dataclass(frozen=True, slots=True)
class FingerMotion:
    """The result of a motion of fingers."""

    positions: Mapping[str, float]  # final joint positions of the gripper by name
    share: float  # final opening of the gripper, from 0 (closed) to 1 (open)
    stopped_by: Sequence[CollisionPair] = ()  # links that stop the fingers, largest overlap first; empty if none does
    gap: float = 2 * CLEAR  # distance in m between the fingers and the released object, at most 2 * CLEAR


def _share_open(gripper: Gripper, now: Mapping[str, float]) -> float:
    """Return the opening of a gripper, from 0 (closed) to 1 (open), at joint positions in rad or m by name."""
    closed, opened = gripper.at(0.0), gripper.at(1.0)
    shares = [(now[name] - at) / (opened[name] - at) for name, at in closed.items() if opened[name] != at]
    return min(1.0, max(0.0, sum(shares) / len(shares))) if shares else 0.0


def finger_motion(
    robot: Object,
    arm: Arm,
    goal: float,
    *,
    posture: Mapping[str, float] | None = None,
    release: Object | None = None,
    pose: Pose | None = None,
    base: Pose | None = None,
) -> FingerMotion:
    """Return how far the fingers of an arm can move. Present overlaps stop the fingers only if they get deeper.

    The ``goal`` is an opening of the gripper, from 0 (closed) to 1 (open). The ``posture`` has joint positions of the
    arm, and ``pose`` is the pose of the released object; None stands for the present posture or pose. The released
    object doesn't stop the fingers, but objects on the released object do.
    """
    gripper = arm.gripper
    clone = clone_of(robot.world, "reach")
    clone.sync()
    now = robot.get_joint_positions()
    there = {**now, **(posture or {})}
    if posture is None and base is None:
        palm = robot.world.engine.link_pose(robot.handle, gripper.palm)
    else:
        frame = robot.urdf.forward_kinematics(there, gripper.palm)
        palm = geometry.multiply(base or robot.get_position_and_orientation(), frame)
    loads = [] if release is None else release.carried
    absent = robot, release, *(load.body for load in loads)
    others = _near(clone, robot, gripper, palm, there, [o for o in robot.world.objects if o not in absent])
    if not others and release is None:  # nothing is near, so no simulation clone is necessary
        return FingerMotion(gripper.at(goal), goal)
    engine, hand = clone.engine, clone.body(robot.name)

    def depths(share: float) -> Depths:
        engine.pose_joints(hand, coupled(robot, gripper.at(share)))
        return _depths(engine, hand, gripper, others)

    try:
        if base is not None:
            engine.set_pose(hand, base)
        engine.pose_joints(hand, there)
        for load in loads:
            others[load.body, ""] = clone.body(load.body.name)
            if pose is not None:
                engine.set_pose(others[load.body, ""], geometry.multiply(pose, load.pose))
        free, stops = _sweep(depths, _share_open(gripper, now), goal) if others else (goal, {})
        gap = 2 * CLEAR
        if release is not None:
            copy = clone.body(release.name)
            if pose is not None:
                engine.set_pose(copy, pose)
            engine.pose_joints(hand, coupled(robot, gripper.at(free)))
            touches = [t for finger in gripper.fingers for t in engine.link_closest_points(hand, finger, copy, gap)]
            gap = min((touch.distance for touch in touches), default=gap)
    finally:
        clone.invalidate(*(body.name for body in absent if body is not None))
    return FingerMotion(gripper.at(free), free, _pairs(robot, stops), gap)


@dataclass(frozen=True, slots=True)
class Closing:
    """A gripper that has closed on an object."""

    positions: Mapping[str, float]  # joint positions of the gripper by name
    sides: int  # number of sides of the object with a finger: 0, 1 or 2; a suction cup counts as 2
    obstacles: Sequence[CollisionPair] = ()  # other links that the fingers would overlap, deepest first


def close_around(
    robot: Object, arm: Arm, posture: Mapping[str, float], body: Object, base: Pose | None = None
) -> Closing | None:
    """Return how a gripper closes on an object, from open until the first touch; None if it never touches the object.

    In a hand with many fingers, fingers without contact continue until they touch the object, as their motors would.
    The ``posture`` has joint positions by name, with the gripper at the object.
    """
    gripper = arm.gripper
    clone = clone_of(robot.world, "reach")
    clone.sync()
    engine, hand, target = clone.engine, clone.body(robot.name), clone.body(body.name)

    parts = _parts(robot, gripper)
    moving = [finger for fingers, _ in parts for finger in fingers]

    def touches(share: float, fingers: Sequence[str] = moving, joints: Sequence[str] = gripper.joints) -> bool:
        at = gripper.at(share)
        engine.pose_joints(hand, coupled(robot, {joint: at[joint] for joint in joints}))
        return any(
            touch.distance < -_SLACK for finger in fingers for touch in engine.link_closest_points(hand, finger, target)
        )

    try:
        if base is not None:
            engine.set_pose(hand, base)
        there = {**robot.get_joint_positions(), **posture}
        engine.pose_joints(hand, there)
        if gripper.suction:
            return Closing({}, 2) if engine.link_closest_points(hand, gripper.palm, target, _AT_CUP) else None
        # closed fingers may be inside of a hollow object, so the search begins with open fingers
        tried = (step / _CLOSING_STEPS for step in reversed(range(_CLOSING_STEPS)))
        stuck = next((share for share in tried if touches(share)), None)
        if stuck is None:
            return None
        free = stuck + 1.0 / _CLOSING_STEPS
        for _ in range(_CLOSING_HALVINGS):
            share = (free + stuck) / 2
            if touches(share):
                stuck = share
            else:
                free = share
        positions = gripper.at(stuck)
        # each of many fingers continues until it touches the object
        for own, joints in parts if len(parts) >= _MANY else ():
            shares = (stuck - step / _ALONE for step in range(math.ceil(stuck * _ALONE)))
            end = gripper.at(next((share for share in shares if touches(share, own, joints)), 0.0))
            positions |= {joint: end[joint] for joint in joints}
        engine.pose_joints(hand, coupled(robot, positions))
        sides = _sides(engine, hand, target, arm, len(parts))
        rest = [other for other in robot.world.objects if other not in (robot, body)]
        others = _near(clone, robot, gripper, engine.link_pose(hand, gripper.palm), there, rest)
        depths = _depths(engine, hand, gripper, others)
    finally:
        clone.invalidate(robot.name)
    return Closing(positions, sides, _pairs(robot, {key: depth for key, depth in depths.items() if depth >= DEPTH}))


def sides_held(robot: Object, arm: Arm, body: Object) -> int:
    """Return the number of sides of an object at which an arm has fingers now: 0, 1 or 2; see :class:`Closing`."""
    engine, gripper = robot.world.engine, arm.gripper
    if gripper.suction:
        return 2 if engine.link_closest_points(robot.handle, gripper.palm, body.handle, _AT_CUP) else 0
    return _sides(engine, robot.handle, body.handle, arm, len(_parts(robot, gripper)))


def _sides(engine: Engine, hand: LoadedBody, target: LoadedBody, arm: Arm, parts: int) -> int:
    """Return the number of sides of a body with fingers; ``parts`` is the number of parts that move independently."""
    _, turn = arm.tool_pose(engine.link_pose(hand, arm.tool_frame))
    across = geometry.rotate(turn, (0.0, 1.0, 0.0))
    least = _AROUND if parts >= _MANY else _ACROSS
    sides = set()
    for finger in arm.gripper.fingers:
        for touch in engine.link_closest_points(hand, finger, target, _REACH):
            along = sum(a * b for a, b in zip(touch.normal, across, strict=True))
            sides |= {math.copysign(1.0, along)} if abs(along) > least else set()
    return len(sides)


def _parts(robot: Object, gripper: Gripper) -> list[tuple[list[str], list[str]]]:
    """Return the finger links and the joints of each part of a gripper that moves independently."""
    urdf, opened, closed = robot.urdf, gripper.at(1.0), gripper.at(0.0)
    parts: dict[str, tuple[list[str], list[str]]] = {}
    for finger in gripper.fingers:
        chain = [joint.name for joint in urdf.chain(urdf.root, finger)]
        joints = [joint for joint in chain if opened.get(joint) != closed.get(joint)]
        if joints:
            mimic = urdf.mimics.get(joints[0])
            fingers, moving = parts.setdefault(mimic.leader if mimic else joints[0], ([], []))
            fingers.append(finger)
            moving.extend(joint for joint in joints if joint not in moving)
    return list(parts.values())


def _depths(engine: Engine, hand: LoadedBody, gripper: Gripper, others: Mapping[Part, LoadedBody]) -> Depths:
    found: dict[tuple[str, Object, str], float] = {}
    for finger in gripper.fingers:
        for (body, link), copy in others.items():
            for touch in engine.link_closest_points(hand, finger, copy):
                key = finger, body, link or touch.link_b
                found[key] = max(found.get(key, 0.0), -touch.distance)
    return found


def _pairs(robot: Object, depths: Depths) -> list[CollisionPair]:
    return [
        CollisionPair(robot.name, finger, body.name, link_name(body, link), depth)
        for (finger, body, link), depth in sorted(depths.items(), key=lambda item: -item[1])
    ]


def _near(
    clone: PosingClone,
    robot: Object,
    gripper: Gripper,
    palm: Pose,
    there: Mapping[str, float],
    bodies: Sequence[Object],
) -> dict[Part, LoadedBody]:
    """Return the copies of objects that fingers may touch between open and closed; ``palm`` is the palm's pose."""
    path = robot.model.path
    others = tuple((name, there[name]) for name in _between(path, gripper) if name in there)
    return clone.overlapping(_swept(path, gripper, others).placed(palm), bodies)


@lru_cache(maxsize=_CACHED)
def _between(path: Path, gripper: Gripper) -> tuple[str, ...]:
    """Return the joints between palm and fingers that the gripper doesn't move."""
    urdf = stored_tree(path)
    to_palm = {joint.name for joint in urdf.chain(urdf.root, gripper.palm)}
    to_fingers = {joint.name for finger in gripper.fingers for joint in urdf.chain(urdf.root, finger)}
    leaders = {name: mimic.leader for name, mimic in urdf.mimics.items()}
    moving = {leaders.get(joint, joint) for joint in gripper.joints}
    return tuple(sorted(name for name in to_palm ^ to_fingers if leaders.get(name, name) not in moving))


@lru_cache(maxsize=_CACHED)
def _swept(path: Path, gripper: Gripper, others: tuple[tuple[str, float], ...]) -> Boxes:
    """Return boxes in the palm's frame around the space of moving fingers; ``others``: joints of :func:`_between`."""
    urdf = stored_tree(path)
    paths: dict[str, list[Pose]] = {finger: [] for finger in gripper.fingers}
    for step in range(_SWEPT + 1):
        given = gripper.at(step / _SWEPT)
        mimics = [(urdf.mimics[name], value) for name, value in given.items() if name in urdf.mimics]
        leaders = {each.leader: (value - each.offset) / each.multiplier for each, value in mimics if each.multiplier}
        at = dict(others) | leaders | given
        palm_T_root = geometry.invert(urdf.forward_kinematics(at, gripper.palm))
        for finger, poses in paths.items():
            poses.append(geometry.multiply(palm_T_root, urdf.forward_kinematics(at, finger)))
    return Boxes.swept(path, paths)


def _sweep(depths: Callable[[float], Depths], start: float, goal: float) -> tuple[float, Depths]:
    """Return the last opening before an obstacle stops the fingers on their way to the goal, and the overlaps."""
    known = depths(start)

    def stopping(share: float) -> Depths:
        return {key: depth for key, depth in depths(share).items() if depth > known.get(key, 0.0) + _SLACK}

    free, count = start, max(1, math.ceil(abs(goal - start) * _STEPS))
    for number in range(1, count + 1):
        share = start + (goal - start) * number / count
        stops = stopping(share)
        if stops:
            for _ in range(_HALVINGS):
                half = (free + share) / 2
                deeper = stopping(half)
                if deeper:
                    share, stops = half, deeper
                else:
                    free = half
            return free, stops
        free = share
    return free, {}
