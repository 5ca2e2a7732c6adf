"""Inverse kinematics of a robot in the world (thesis 4.4.5): which postures bring a link to a pose.

Postures come from :mod:`pycram.reasoning.kinematics.arm`, which keeps to joint limits; the world isn't touched.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

from pycram.reasoning.kinematics.arm import THRESHOLD, ArmKinematics, Posture
from pycram.reasoning.kinematics.chain import Chain
from recorder import geometry
from recorder.geometry import IDENTITY

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from pycram.world.object import Object
    from recorder.geometry import Pose, PoseLike, Quaternion, Vector

    #: Position and orientation in the world, and the pose that the robot's base is taken to have.
    Target = tuple[Sequence[float], Sequence[float] | None, PoseLike | None]

_MAX_CHAINS: Final = 16  # of a robot that are kept


def postures(
    robot: Object,
    link: str,
    position: Sequence[float],
    orientation: Sequence[float] | None,
    *,
    thorough: bool = False,
    quick: bool = False,
    seed: Mapping[str, float] | None = None,
) -> list[Posture]:
    """Return postures that bring a link of a robot to one pose in the world; see :meth:`Solver.search`."""
    target = (position, orientation, None)
    return Solver(robot, link).search([target], thorough=thorough, quick=quick, seed=seed)[0]


class Solver:
    """Inverse kinematics of one link of a robot as it stands, for targets in the world.

    Args:
        robot: the robot.
        link: the link with an arm's tool frame, which is then what is brought to targets, or any other link.

    Attributes:
        joints: names of the joints that bring the link to a target.

    Raises:
        UnknownName: the robot has no such link.
    """

    def __init__(self, robot: Object, link: str) -> None:
        robot.check_link(link)
        self._arm = robot.description.arm_of(link) if robot.description else None
        if self._arm is not None:
            root, self.joints = self._arm.base_link, self._arm.joints
        else:
            chain = robot.urdf.chain(robot.base_link, link)
            turning = [joint for joint in chain if joint.movable and joint.type != "prismatic"]
            root = turning[0].parent if turning else robot.base_link
            self.joints = tuple(joint.name for joint in turning)
        self._now = robot.get_joint_positions()
        tool = self._arm.tool_offset if self._arm else IDENTITY
        self._kinematics = _kinematics(robot, root, link, self.joints, self._now, tool)
        self._root_T_world = geometry.invert(robot.get_link_position_and_orientation(root))
        self._root_T_link = geometry.transform(self._root_T_world, robot.get_link_position(link))
        self._root_T_base = geometry.multiply(self._root_T_world, robot.get_position_and_orientation())

    def search(
        self,
        targets: Sequence[Target],
        *,
        thorough: bool = False,
        quick: bool = False,
        seed: Mapping[str, float] | None = None,
        threshold: float = THRESHOLD,
    ) -> list[list[Posture]]:
        """Return postures for targets, nearest to the present one first.

        Args:
            targets: poses; all of them with an orientation, or none.
            thorough: look for several.
            quick: don't look long; a miss then proves nothing.
            seed: posture to start from; the present one by default.
            threshold: m that are near enough.

        Returns:
            For each target at least one; if the first doesn't reach, none does.
        """
        if not self.joints:
            distances = (math.dist(geometry.transform(self._root_T_world, at), self._root_T_link) for at, *_ in targets)
            return [[Posture({}, distance, 0.0)] for distance in distances]
        if not targets:
            return []
        seeds = [self._now if seed is None else seed]
        if self._arm is not None:
            seeds += [self._arm.posture(name) for name in self._arm.poses]
        goals = [self._in_root(*target) for target in targets]
        return self._kinematics.solve(goals, seeds, thorough=thorough, quick=quick, enough=threshold)

    @property
    def in_closed_form(self) -> bool:
        """Whether the joints are solved in closed form."""
        return bool(self.joints) and self._kinematics.in_closed_form

    def closed_form(self, targets: Sequence[Target], seed: Mapping[str, float] | None = None) -> list[list[Posture]]:
        """Return postures for targets that are found without searching, nearest to the seed first, as :meth:`search`.

        An empty list proves nothing.
        """
        if not self.joints:
            return [[] for _ in targets]
        goals = [self._in_root(*target) for target in targets]
        return self._kinematics.closed_form(goals, self._now if seed is None else seed)

    def _in_root(
        self, position: Sequence[float], orientation: Sequence[float] | None, base: PoseLike | None
    ) -> tuple[Vector, Quaternion | None]:
        root_T_world = self._root_T_world
        if base is not None:
            root_T_world = geometry.multiply(self._root_T_base, geometry.invert(base))
        turn = None if orientation is None else geometry.product(root_T_world[1], orientation)
        return geometry.transform(root_T_world, position), turn


_chains: WeakKeyDictionary[Object, dict[Hashable, ArmKinematics]] = WeakKeyDictionary()


def _kinematics(
    robot: Object, root: str, link: str, joints: Sequence[str], now: Mapping[str, float], tool: Pose
) -> ArmKinematics:
    """Return a chain's kinematics, which are kept: making them takes as long as solving them."""
    others = [joint.name for joint in robot.urdf.chain(root, link) if joint.movable and joint.name not in joints]
    key = (link, *(now[name] for name in others))
    chains = _chains.setdefault(robot, {})
    if key not in chains:
        if len(chains) >= _MAX_CHAINS:
            chains.clear()
        chains[key] = ArmKinematics(Chain(robot.urdf, root, link, joints, now, tool))
    return chains[key]
