"""Maps of the floor: how well a robot could stand on each cell to reach or see something, and with which heading."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.driving import drives
from pycram.reasoning.places import maps, reaching
from pycram.reasoning.places.arm_reach import arm_reach
from pycram.reasoning.places.grid import Grid
from pycram.reasoning.places.outline import room, surroundings
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pycram.models.robots.description import Arm
    from pycram.reasoning.places.reaching import Goal
    from pycram.world.object import Object
    from recorder.geometry import Vector

    Array = NDArray[np.float64]

_OFFSETS: Final = tuple(math.radians(angle) for angle in range(-75, 76, 15))  # of the heading from facing the target
_FACING: Final = 0.5  # how much it counts to face the target, at right angles to it
_SIGHT: Final = (0.6, 2.5)  # m from which something is seen well, and up to which places are looked for
_ROOM: Final = 1.5  # m around a point that a place is to be near
_NEAR: Final = 0.7  # m at which a place near a point counts half
_SHORT_WAY: Final = 8.0  # m of driving that count half
_LEVEL: Final = 0.05  # m above what is reached: what is lower isn't between


class StandingMaps:
    """Maps of the floor for a robot.

    Args:
        robot: the robot.
        goals: what shall be reached, all of it.
        arms: that may reach.
        both: whether each of these arms shall.
        see: what the camera shall see; None for nothing.
        near: that the robot shall be near, m; None for anywhere.
        purpose: what it stands there for, in words.
    """

    def __init__(
        self,
        robot: Object,
        goals: Sequence[Goal],
        arms: Sequence[Arm],
        both: bool,
        see: Object | None,
        near: Vector | None,
        purpose: str,
    ) -> None:
        self._robot, self._goals, self._arms, self._both = robot, goals, arms, both
        self._see, self._near, self._purpose = see, near, purpose

    def is_near(self, place: Sequence[float]) -> bool:
        """Whether a place is as near as it shall be."""
        return self._near is None or math.dist(place[:2], self._near[:2]) <= _ROOM

    def of(self) -> tuple[Grid, list[tuple[str, Array]], Array]:
        """Return the cells, a map (cells,) for each constraint by its name, and the heading (cells,) for each, rad."""
        robot = self._robot
        here, turn = robot.get_position_and_orientation()
        grid = self._grid(here)
        centers = grid.centers()
        factors: list[tuple[str, Array]] = [("distance", maps.near(centers, here, _SHORT_WAY))]
        yaws = np.full(len(centers), geometry.to_rpy(turn)[2])
        cells = np.arange(len(centers))  # what isn't excluded yet: the others need no further look
        if self._goals or self._see is not None:
            faced, yaws = self._faced(centers, here[2])
            cells = np.flatnonzero(faced)
            factors.append((self._purpose, faced))
            for goal in self._goals:
                straight = self._straight(centers[cells], goal)
                factors.append((self._purpose, maps.scattered(straight, cells, len(centers))))
        if drives(robot):
            factors.append(("collision", maps.scattered(room(robot, centers[cells]), cells, len(centers))))
        if self._near is not None:
            factors.append(("near", maps.near(centers, self._near, _NEAR, _ROOM)))
        return grid, factors, yaws

    def _straight(self, centers: Array, goal: Goal) -> Array:
        """Return little where something is between a place and a goal, at the height of what would be reached."""
        x, y, z = goal.position
        target = [goal.body] if isinstance(goal, reaching.Taking) else []
        between = maps.Footprints(surroundings(self._robot, *target), z, z + _LEVEL)
        return maps.straight(centers, (x, y), between)

    def _grid(self, here: Sequence[float]) -> Grid:
        """Return the cells from which everything may be reached and seen."""
        areas: list[tuple[Sequence[float], float]] = []
        if self._goals:
            radius = max(arm_reach(self._robot, arm).radius for arm in self._arms)
            areas += [(goal.position, radius) for goal in self._goals]
        if self._see is not None:
            areas.append((center(self._see), _SIGHT[1]))
        if not areas:
            areas.append((self._near or here, _ROOM))
        low = [max(point[axis] - radius for point, radius in areas) for axis in (0, 1)]
        high = [min(point[axis] + radius for point, radius in areas) for axis in (0, 1)]
        return Grid.over(low, high, here[2])

    def _faced(self, centers: Array, ground: float) -> tuple[Array, Array]:
        """Return for all cells how well everything is reached or seen with the best heading, and that heading."""
        points = [goal.position for goal in self._goals] or ([center(self._see)] if self._see is not None else [])
        offsets = np.asarray(points)[None, :, :2] - centers[:, None]  # (cells, points, 2)
        distances, bearings = np.hypot(offsets[..., 0], offsets[..., 1]), np.arctan2(offsets[..., 1], offsets[..., 0])
        middle = offsets.mean(axis=1)
        facing = np.arctan2(middle[:, 1], middle[:, 0])
        best, yaws = np.full(len(centers), -1.0), facing.copy()
        for offset in _OFFSETS if self._goals else (0.0,):
            score = np.full(len(centers), 1.0 - _FACING * abs(offset) / (math.pi / 2))
            for number, point in enumerate(points):
                if self._goals:
                    score *= self._by_arms(
                        point[2] - ground, distances[:, number], bearings[:, number] - facing - offset
                    )
            if self._see is not None:
                good, far = _SIGHT
                away = np.hypot(*(np.asarray(center(self._see)[:2]) - centers).T)
                score *= np.where(away < good, away / good, np.clip((far - away) / (far - good), 0.0, 1.0))
            better = score > best
            best[better], yaws[better] = score[better], (facing + offset)[better]
        return best, yaws

    def _by_arms(self, height: float, distance: Array, bearing: Array) -> Array:
        """Return how well one of the arms, or each of them, reaches points."""
        every = []
        base_T_world = geometry.invert(self._robot.get_position_and_orientation())
        for arm in self._arms:
            shoulder = geometry.transform(base_T_world, self._robot.get_link_position(arm.base_link))
            every.append(arm_reach(self._robot, arm).scores(height - shoulder[2], distance, bearing))
        together: Array = np.min(every, axis=0) if self._both else np.max(every, axis=0)
        return together
