"""What a robot's arm can reach, and what would be in its way (thesis 4.4.5, 4.4.6).

Postures come from :mod:`pycram.reasoning.kinematics.arm`, which keeps to joint limits; what they would touch is looked
for by :mod:`pycram.reasoning.collision.checker`. Neither touches the world.

Grasps are named by the side of the object that the gripper comes from, as seen by the robot: "front" is the side that
faces it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

from pycram.foundation import checks
from pycram.foundation.failures import UnknownName
from pycram.reasoning.kinematics.arm import ArmKinematics, Posture
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from pycram.world.object import Object
    from recorder.geometry import PoseLike, Quaternion, Vector

    Target = tuple[Sequence[float], Sequence[float] | None, PoseLike | None]

_KEPT: Final = 16  # chains of a robot
THRESHOLD: Final = 1e-3  # m between tool and target that count as reached (thesis 4.4.5)


def approach(grasp: str, robot: Object) -> Quaternion:
    """Orientation of the tool for a grasp, in the world.

    Args:
        grasp: "front", "top", "left" or "right".
        robot: whose heading says what is front.

    Raises:
        UnknownName: another grasp.
    """
    if checks.text("grasp", grasp) not in GRASPS:
        raise UnknownName("grasp", grasp, "a gripper", GRASPS)
    return geometry.product(heading(robot), GRASPS[grasp])


def heading(robot: Object) -> Quaternion:
    """Where a robot looks: its orientation about the vertical.

    Args:
        robot: the robot, as it stands.
    """
    x, y, _ = geometry.rotate(robot.get_orientation(), (1.0, 0.0, 0.0))
    return geometry.from_rpy(0.0, 0.0, math.atan2(y, x))


GRASPS: Final[Mapping[str, Quaternion]] = {
    "front": (0.0, 0.0, 0.0, 1.0),
    "top": geometry.from_rpy(0.0, math.pi / 2, 0.0),
    "left": geometry.from_rpy(0.0, 0.0, -math.pi / 2),  # from the robot's left side to its right
    "right": geometry.from_rpy(0.0, 0.0, math.pi / 2),
}
"""Tool orientations in a frame that has the robot's heading."""


@dataclass(frozen=True, slots=True)
class Reach:
    """How a link gets to a target.

    Attributes:
        posture: the joints that move, and how near they bring it.
        link: the link that is to get there.
    """

    posture: Posture
    link: str

    def reached(self, threshold: float) -> bool:
        """Whether position (and orientation, if one was asked for) are within tolerance."""
        return self.posture.position_error <= threshold and self.posture.turn_error < math.radians(2)

    def evidence(self) -> dict[str, object]:
        """As records carry it."""
        posture = self.posture
        return {"joints": posture.positions, "distance": posture.position_error, "turn": posture.turn_error}


def moving_joints(robot: Object, link: str) -> tuple[str, tuple[str, ...]]:
    """The joints that bring a link to a target, and the link that they hang on.

    Args:
        robot: the robot.
        link: an arm's tool frame, or any other of its links.

    Raises:
        UnknownName: there is no such link.
    """
    robot.check_link(link)
    arm = robot.description.arm_of(link) if robot.description else None
    if arm is not None:
        return arm.base_link, arm.joints
    chain = [joint for joint in robot.urdf.chain(robot.base_link, link) if joint.movable and joint.type != "prismatic"]
    if not chain:
        return robot.base_link, ()
    return chain[0].parent, tuple(joint.name for joint in chain)


def postures(
    robot: Object,
    link: str,
    position: Sequence[float],
    orientation: Sequence[float] | None,
    *,
    thorough: bool = False,
    quick: bool = False,
    seed: Mapping[str, float] | None = None,
) -> list[Reach]:
    """Postures that bring a link of a robot to a pose in the world, nearest to its present one first.

    Args:
        robot: the robot, as it stands.
        link: an arm's tool frame, or any other of its links.
        position: xyz in the world, m.
        orientation: xyzw in the world, None if any will do.
        thorough: look for several.
        quick: don't look long; a miss then proves nothing.
        seed: posture to start from; the present one by default.

    Returns:
        At least one; if the first doesn't reach, none does.
    """
    return Solver(robot, link).postures(position, orientation, thorough=thorough, quick=quick, seed=seed)


class Solver:
    """Inverse kinematics of one link of a robot as it stands, for targets in the world.

    Args:
        robot: the robot.
        link: an arm's tool frame, or any other of its links.
    """

    def __init__(self, robot: Object, link: str) -> None:
        root, self.joints = moving_joints(robot, link)
        self._link = link
        self._now = robot.get_joint_positions()
        self._arm = robot.description.arm_of(link) if robot.description else None
        self._kinematics = _kinematics(robot, root, link, self.joints, self._now)
        self._root_T_world = geometry.invert(robot.get_link_position_and_orientation(root))
        self._root_T_link = geometry.transform(self._root_T_world, robot.get_link_position(link))
        self._root_T_base = geometry.multiply(self._root_T_world, robot.get_position_and_orientation())

    def postures(
        self,
        position: Sequence[float],
        orientation: Sequence[float] | None,
        *,
        thorough: bool = False,
        quick: bool = False,
        seed: Mapping[str, float] | None = None,
        base: PoseLike | None = None,
        threshold: float = THRESHOLD,
    ) -> list[Reach]:
        """See :func:`postures`; ``base`` is where the robot's base is taken to be, ``threshold`` m are near enough."""
        (found,) = self.searched(
            [(position, orientation, base)], thorough=thorough, quick=quick, seed=seed, threshold=threshold
        )
        return found

    def searched(
        self,
        targets: Sequence[Target],
        *,
        thorough: bool = False,
        quick: bool = False,
        seed: Mapping[str, float] | None = None,
        threshold: float = THRESHOLD,
    ) -> list[list[Reach]]:
        """As :meth:`postures`, for many targets.

        Args:
            targets: positions and orientations in the world, for all or for none, and where the robot's base is taken
                to be.
            thorough: look for several.
            quick: don't look long; a miss then proves nothing.
            seed: posture to start from; the present one by default.
            threshold: m that are near enough.

        Returns:
            For each at least one; if the first doesn't reach, none does.
        """
        if not self.joints:
            ways = [math.dist(geometry.transform(self._root_T_world, at), self._root_T_link) for at, _, _ in targets]
            return [[Reach(Posture({}, away, 0.0, away < THRESHOLD), self._link)] for away in ways]
        if not targets:
            return []
        start = self._now if seed is None else seed
        seeds = [start, *(self._arm.posture(name) for name in self._arm.poses)] if self._arm else [start]
        wanted = [self._in_root(*target) for target in targets]
        found = self._kinematics.solve_all(wanted, seeds, thorough=thorough, quick=quick, enough=threshold)
        return [[Reach(posture, self._link) for posture in each] for each in found]

    def at_once(self, targets: Sequence[Target]) -> list[list[Reach]]:
        """Postures for many targets that are found without searching; an empty list says nothing.

        Args:
            targets: as for :meth:`searched`.
        """
        if not self.joints:
            return [[] for _ in targets]
        found = self._kinematics.at_once([self._in_root(*target) for target in targets], self._now)
        return [[Reach(posture, self._link) for posture in each] for each in found]

    def _in_root(
        self, position: Sequence[float], orientation: Sequence[float] | None, base: PoseLike | None
    ) -> tuple[Vector, Quaternion | None]:
        root_T_world = self._root_T_world
        if base is not None:
            root_T_world = geometry.multiply(self._root_T_base, geometry.invert(base))
        turn = None if orientation is None else geometry.product(root_T_world[1], orientation)
        return geometry.transform(root_T_world, position), turn


_made: WeakKeyDictionary[Object, dict[Hashable, ArmKinematics]] = WeakKeyDictionary()


def _kinematics(robot: Object, root: str, link: str, joints: Sequence[str], now: Mapping[str, float]) -> ArmKinematics:
    """A chain's arithmetic, which is kept: making it takes as long as solving it."""
    others = [joint.name for joint in robot.urdf.chain(root, link) if joint.movable and joint.name not in joints]
    key = (link, *(now[name] for name in others))
    mine = _made.setdefault(robot, {})
    if key not in mine:
        if len(mine) >= _KEPT:
            mine.clear()
        mine[key] = ArmKinematics(robot.urdf, root, link, joints, now)
    return mine[key]
