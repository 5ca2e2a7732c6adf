"""Where an arm gets to with its hand level or pointing down: counted once for an arm, over random postures.

Such maps tell where to look (Zacharias, Borst, Hirzinger: Capturing robot workspace structure, IROS 2007); whether an
arm really reaches is what its inverse kinematics says.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.kinematics.chain import Chain
from recorder import geometry

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from pycram.models.robots.description import Arm
    from pycram.world.object import Object
    from recorder.geometry.urdf import Urdf

    Array = NDArray[np.float64]

_POSTURES: Final = 60_000
_PARTS: Final = 30  # of them, one after the other: so many as a processor's cache holds
_LEVEL: Final = math.sin(math.radians(30))  # of the tool's axis along the vertical
_DOWN: Final = -math.cos(math.radians(30))
_CELL: Final = 0.08  # m of distance and height
_SECTORS: Final = 24  # of the bearing, in a full turn
_FULL: Final = 0.9  # quantile of the counts from which on it counts as well reached


class ArmReach:
    """How well an arm gets to places around the robot.

    Args:
        urdf: of the robot.
        arm: the arm.

    Attributes:
        radius: m from the robot's axis that it gets to at most.
    """

    def __init__(self, urdf: Urdf, arm: Arm) -> None:
        chain = Chain(urdf, arm.base_link, arm.tool_frame, arm.joints, tool=arm.tool_offset)
        random = np.random.default_rng(0)
        postures = chain.lower + random.random((_POSTURES, len(arm.joints))) * (chain.upper - chain.lower)
        base_T_root = geometry.pose_matrix(urdf.forward_kinematics({}, arm.base_link))
        tools = np.concatenate([chain.poses(some) for some in np.array_split(postures, _PARTS)])
        turns = base_T_root[:3, :3] @ tools[:, :3, :3]
        points = tools[:, :3, 3] @ base_T_root[:3, :3].T
        across = turns[:, 2, 0]
        points = points[(np.abs(across) < _LEVEL) | (across < _DOWN)]
        flat = points[:, :2] + base_T_root[:2, 3]
        distance = np.hypot(*flat.T)
        self.radius = float(distance.max(initial=0.0))
        self._low = float(points[:, 2].min(initial=0.0))
        shape = (
            int((points[:, 2].max(initial=0.0) - self._low) / _CELL) + 1,
            int(self.radius / _CELL) + 1,
            _SECTORS,
        )
        counts = np.zeros(shape)
        bearing = np.arctan2(flat[:, 1], flat[:, 0])
        np.add.at(counts, self._cells(points[:, 2], distance, bearing, shape), 1.0)
        for axis, wrap in ((0, False), (1, False), (2, True)):  # few postures a cell: neighbours count too
            counts = _smoothed(counts, axis, wrap=wrap)
        counts /= np.maximum(np.arange(shape[1]) + 0.5, 0.5)[None, :, None]  # cells farther out are larger
        full = np.quantile(counts[counts > 0.0], _FULL) if counts.any() else 1.0
        self._scores = np.sqrt(np.minimum(counts / full, 1.0))

    def _cells(
        self, height: Array, distance: Array, bearing: Array, shape: tuple[int, ...]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        z = ((height - self._low) / _CELL).astype(np.intp).clip(0, shape[0] - 1)
        rho = (distance / _CELL).astype(np.intp).clip(0, shape[1] - 1)
        sector = np.round(bearing / (2 * math.pi / _SECTORS)).astype(np.intp) % _SECTORS
        return z, rho, sector

    def scores(self, height: float, distance: Array, bearing: Array) -> Array:
        """Return how well the hand gets to points.

        Args:
            height: of them above the arm's base link, m.
            distance: (...) of them from the robot's axis, m.
            bearing: (...) of them from its heading, counterclockwise, rad.
        """
        every = np.full(distance.shape, height)
        found: Array = self._scores[self._cells(every, distance, bearing, self._scores.shape)]
        outside = (distance > self.radius) | (every < self._low) | (every > self._low + len(self._scores) * _CELL)
        return np.where(outside, 0.0, found)

    def best(self, height: float, distance: Array) -> Array:
        """Return how well the hand gets to points (...), whatever the robot's heading; see :meth:`scores`."""
        z = int((height - self._low) / _CELL)
        if not 0 <= z < len(self._scores):
            return np.zeros(distance.shape)
        by_distance = np.append(self._scores[z].max(axis=1), 0.0)
        found: Array = by_distance[(distance / _CELL).astype(np.intp).clip(0, len(by_distance) - 1)]
        return found


def _smoothed(counts: Array, axis: int, *, wrap: bool) -> Array:
    before, after = (np.roll(counts, step, axis=axis) for step in (1, -1))
    if not wrap:
        first: list[slice | int] = [slice(None)] * counts.ndim
        last = list(first)
        first[axis], last[axis] = 0, -1
        before[tuple(first)], after[tuple(last)] = 0.0, 0.0
    smoothed: Array = (before + 2 * counts + after) / 4
    return smoothed


_known: dict[tuple[Path, str, str], ArmReach] = {}  # by model, description and arm


def arm_reach(robot: Object, arm: Arm) -> ArmReach:
    """Return where an arm of a robot gets to; it is worked out once for a model."""
    key = (robot.model.path, robot.description.text if robot.description else "", arm.name)
    if key not in _known:
        _known[key] = ArmReach(robot.urdf, arm)
    return _known[key]
