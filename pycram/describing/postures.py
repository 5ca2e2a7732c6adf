"""Postures of arms that are being described: where they are parked, and which links overlap in all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.kinematics.forward import Chain
from pycram.reasoning.kinematics.inverse import spread
from recorder import geometry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pycram.models.robots.arm import Arm
    from pycram.world.object import Object

    Array = NDArray[np.float64]

_TRIED: Final = 4000  # postures among which one to park in is looked for
_CHECKED: Final = 300  # of them that are checked for self collisions, best first
_SAMPLED: Final = 40  # postures in which links that always overlap do so
_FLOOR: Final = 0.05  # m above the root link that arms stay
_STRAIN: Final = 0.1  # m that a posture at joint limits may be larger than one in the middle


def chain_of(robot: Object, arm: Arm) -> Chain:
    """Return the kinematics of an arm as the robot stands."""
    now = robot.get_joint_positions()
    return Chain(robot.urdf, arm.base_link, arm.tool_frame, arm.joints, now, arm.tool_offset)


def always_touching(robot: Object, arm: Arm) -> set[tuple[str, str]]:
    """Return pairs of links that overlap in all postures of an arm that are looked at: their shapes do, not they."""
    chain = chain_of(robot, arm)
    postures = [dict(zip(arm.joints, row, strict=True)) for row in spread(chain, 0, _SAMPLED).tolist()]
    with CollisionChecker(robot, arm.joints) as checker:
        found = [
            {(pair.link, pair.body_link) for pair in checker.self_collisions(candidate)}
            for candidate in checker.predict(postures)
        ]
    return set.intersection(*found) if found else set()


def parked(robot: Object, arm: Arm) -> list[float]:
    """Return a compact posture in which the robot doesn't touch itself; its other arms are where they are."""
    chain = chain_of(robot, arm)
    postures = chain.limited(spread(chain, 0, _TRIED))
    root = geometry.pose_matrix(robot.urdf.forward_kinematics(robot.get_joint_positions(), arm.base_link))
    frames = np.concatenate([chain.frames(postures), chain.poses(postures)[None]])
    points = (root @ frames)[:, :, :3, 3]
    size = np.hypot(points[:, :, 0], points[:, :, 1]).max(axis=0)
    low = np.maximum(_FLOOR - points[:, :, 2].min(axis=0), 0.0)
    middle = np.abs((postures - chain.lower) / (chain.upper - chain.lower) - 0.5).max(axis=1)
    order = np.argsort(size + 10 * low + _STRAIN * 2 * middle, kind="stable")[:_CHECKED]
    rows = postures[order].round(3).tolist()
    with CollisionChecker(robot, arm.joints) as checker:
        named = [dict(zip(arm.joints, row, strict=True)) for row in rows]
        for row, candidate in zip(rows, checker.predict(named), strict=True):
            if not checker.self_collisions(candidate):
                return [float(value) for value in row]
    return [float(value) for value in chain.limited(np.zeros((1, len(arm.joints))))[0].round(3)]
