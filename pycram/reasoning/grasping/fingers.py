"""Fingers that open or close until something stops them: found in a simulation clone, before they move."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

from pycram.foundation.collision_pair import CollisionPair
from pycram.reasoning.collision.simulation_clone import clone_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pycram.models.robots.description import Arm, Gripper
    from pycram.world.object import Object
    from recorder.geometry import Pose

    #: Depths in m of what fingers overlap: finger, object, the object's link.
    Depths: TypeAlias = Mapping[tuple[str, Object, str], float]

CLEAR: Final = 0.002  # m of air around what is let go of: the engine pads shapes by less
_SLACK: Final = 5e-4  # m of overlap that is a touch
_STEPS: Final = 16  # of the way between open and closed: no finger of the PR2 moves by more than 3 mm in one
_HALVINGS: Final = 6  # of such a step
_NEAR: Final = 0.25  # m from the tool frame: fingers don't get farther


@dataclass(frozen=True, slots=True)
class FingerMotion:
    """How far fingers get.

    Attributes:
        positions: joint values of the gripper there, by name.
        share: how far it is open then: 0 is closed, 1 is open.
        stopped_by: what stops the fingers, deepest first; nothing if they get as far as they should.
        gap: m of air between the fingers and what is let go of, at most 2 * CLEAR.
    """

    positions: Mapping[str, float]
    share: float
    stopped_by: Sequence[CollisionPair] = ()
    gap: float = 2 * CLEAR


def share_open(robot: Object, gripper: Gripper) -> float:
    """Return how far a gripper is open: 0 is closed, 1 is open."""
    closed, opened, now = gripper.at(0.0), gripper.at(1.0), robot.get_joint_positions()
    shares = [(now[name] - at) / (opened[name] - at) for name, at in closed.items() if opened[name] != at]
    return min(1.0, max(0.0, sum(shares) / len(shares))) if shares else 0.0


def moved(
    robot: Object,
    arm: Arm,
    goal: float,
    *,
    posture: Mapping[str, float] | None = None,
    release: Object | None = None,
    pose: Pose | None = None,
) -> FingerMotion:
    """Return how far the fingers of an arm get from where they are.

    What they overlap already doesn't stop them unless they go deeper.

    Args:
        robot: the robot; its world's lock is held.
        arm: the arm.
        goal: how far the gripper shall be open: 0 is closed, 1 is open.
        posture: joint values of the arm by name; the present ones by default.
        release: what is let go of, which doesn't stop the fingers.
        pose: of that; where it is by default.
    """
    gripper = arm.gripper
    clone = clone_of(robot.world, "reach")
    bodies = clone.sync()
    engine, hand = clone.engine, bodies[robot.name]
    joints = {**robot.get_joint_positions(), **(posture or {})}
    engine.pose_joints(hand, joints)
    tool = arm.tool_pose(engine.link_pose(hand, arm.tool_frame))[0]
    others = [body for body in robot.world.objects if body not in (robot, release) and _is_near(body, tool)]

    def depths(share: float) -> Depths:
        engine.pose_joints(hand, {**joints, **gripper.at(share)})
        found: dict[tuple[str, Object, str], float] = {}
        for finger in gripper.fingers:
            for body in others:
                for touch in engine.link_closest_points(hand, finger, bodies[body.name]):
                    key = finger, body, touch.link_b
                    found[key] = max(found.get(key, 0.0), -touch.distance)
        return found

    try:
        free, stops = _sweep(depths, share_open(robot, gripper), goal)
        gap = 2 * CLEAR
        if release is not None:
            copy = bodies[release.name]
            if pose is not None:
                engine.set_pose(copy, pose)
            engine.pose_joints(hand, {**joints, **gripper.at(free)})
            touches = [t for finger in gripper.fingers for t in engine.link_closest_points(hand, finger, copy, gap)]
            gap = min((touch.distance for touch in touches), default=gap)
    finally:
        clone.invalidate(robot.name, *([release.name] if release is not None else []))
    pairs = [
        CollisionPair(robot.name, finger, body.name, link if len(body.links) > 1 else "", depth)
        for (finger, body, link), depth in sorted(stops.items(), key=lambda item: -item[1])
    ]
    return FingerMotion(gripper.at(free), free, pairs, gap)


def _is_near(body: Object, tool: Sequence[float]) -> bool:
    low, high = body.get_AABB()
    return all(a - _NEAR <= x <= b + _NEAR for a, x, b in zip(low, tool, high, strict=True))


def _sweep(depths: Callable[[float], Depths], start: float, goal: float) -> tuple[float, Depths]:
    """Return the last share on the way from one to another at which nothing stops the fingers, and what does then."""
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
