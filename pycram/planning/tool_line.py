"""Straight lines of an arm's tool, as for the last centimetres to a thing: a posture each centimetre."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.foundation import checks
from pycram.foundation.failures import Unreachable
from pycram.reasoning.kinematics.chain import Chain, rotation_error
from pycram.reasoning.kinematics.descent import descend
from pycram.world.joints import checked_positions
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pycram.models.robots.description import Arm
    from pycram.world.object import Object
    from recorder.geometry import PoseLike

_STEP: Final = 0.01  # m of the tool from one posture to the next
_TURN: Final = 0.05  # rad likewise
_JUMP: Final = 0.35  # rad or m of a joint from one posture to the next: more, and the arm changes its posture


def line(robot: Object, arm: Arm, start: Mapping[str, float], goal: PoseLike) -> list[dict[str, float]]:
    """Return postures that bring an arm's tool to a pose on a straight line, with its orientation turning evenly.

    Nothing is checked for collisions.

    Args:
        robot: the robot.
        arm: its arm.
        start: joint values in rad or m by name where the line begins, also of other joints; these stay, and others are
            as they are.
        goal: position and orientation of the tool in the world.

    Returns:
        Postures of all joints of the start, from the start to the end of the line.

    Raises:
        Unreachable: The arm doesn't get there, or would have to change its posture on the way.
    """
    position, orientation = checks.vector("goal", goal[0]), checks.quaternion("goal", goal[1])
    begin = checked_positions(robot, start)
    values = robot.get_joint_positions() | begin
    chain = Chain(robot.urdf, arm.base_link, arm.tool_frame, arm.joints, values, arm.tool_offset)
    base = robot.get_position_and_orientation()
    root = geometry.multiply(base, robot.urdf.forward_kinematics(values, arm.base_link))
    target = geometry.pose_matrix(geometry.multiply(geometry.invert(root), (position, orientation)))
    posture = np.array([values[name] for name in arm.joints])
    tool = chain.poses(posture[None])[0]
    way = target[:3, 3] - tool[:3, 3]
    turn = rotation_error(tool[None, :3, :3], target[:3, :3])[0]
    count = max(1, math.ceil(float(np.linalg.norm(way)) / _STEP), math.ceil(float(np.linalg.norm(turn)) / _TURN))
    postures = [begin | dict(zip(arm.joints, posture.tolist(), strict=True))]
    for number in range(1, count + 1):
        share = number / count
        goals, turns = (tool[:3, 3] + share * way)[None], (_rotation(share * turn) @ tool[:3, :3])[None]
        found, reached = descend(chain, posture[None], goals, turns, np.zeros(1, dtype=np.intp), stop_early=True)
        moved = _turned(found[0] - posture, chain)
        left = float(np.linalg.norm(way)) * (1 - (number - 1) / count)
        if not reached[0]:
            raise Unreachable(arm.name, position, left, "that is as far as it gets on a straight line")
        if np.abs(moved).max() > _JUMP:
            raise Unreachable(arm.name, position, left, "from there it would have to change its posture")
        posture = posture + moved
        postures.append(begin | dict(zip(arm.joints, posture.tolist(), strict=True)))
    return postures


def _turned(change: np.ndarray, chain: Chain) -> np.ndarray:
    """Return the change (joints,) of a posture, of joints without limits by less than half a turn."""
    return np.where(chain.bounded, change, (change + np.pi) % (2 * np.pi) - np.pi)


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 3) that turns about a vector (3,) by its length in rad."""
    angle = float(np.linalg.norm(vector))
    x, y, z = (vector / angle if angle else vector).tolist()
    sine = math.sin(angle / 2)
    return geometry.to_matrix((x * sine, y * sine, z * sine, math.cos(angle / 2)))
