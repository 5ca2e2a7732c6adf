"""Trajectories: target positions of a body's joints or of its base over time.

A trajectory is a cubic Hermite spline, so positions and velocities are continuous. The code uses plain floats in a
fixed order of operations, so a recorded trajectory gives the same targets bit for bit.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite

from pycram.foundation.failures import BadArgument
from recorder import geometry, records
from recorder.geometry import Pose, Quaternion
from recorder.records.motion import BASE_COORDINATES


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A timed motion of a body's joints, or of its base. Infinite values and wrong lengths raise BadArgument."""

    joints: tuple[str, ...]  # names of the joints; for a base, () and coordinates x, y (m) and yaw (rad), world frame
    times: tuple[float, ...]  # n times in s, strictly increasing from 0; n is at least 1
    positions: tuple[tuple[float, ...], ...]  # n rows: a position in rad or m for each coordinate
    velocities: tuple[tuple[float, ...], ...]  # n rows: a velocity in rad/s or m/s for each coordinate

    def __post_init__(self) -> None:
        width = len(self.coordinates)
        if not self.times or self.times[0] != 0 or any(b <= a for a, b in pairwise(self.times)):
            raise BadArgument("times", self.times, "times in s from 0 on, strictly increasing")
        for name, rows in (("positions", self.positions), ("velocities", self.velocities)):
            if len(rows) != len(self.times) or any(len(row) != width for row in rows):
                raise BadArgument(name, rows, f"{len(self.times)} rows of {width} numbers")
            if not all(isfinite(number) for row in rows for number in row):
                raise BadArgument(name, rows, "finite numbers")

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the columns: the joints, or x, y and yaw of the base."""
        return self.joints or BASE_COORDINATES

    @property
    def duration(self) -> float:
        """Duration in s."""
        return self.times[-1]

    def at(self, time: float) -> tuple[Sequence[float], Sequence[float]]:
        """Return positions and velocities at a time in s; velocities before the start and after the end are 0."""
        if time <= 0 or time >= self.duration:
            return self.positions[0 if time <= 0 else -1], (0.0,) * len(self.coordinates)
        after = bisect_right(self.times, time)
        start, end = self.times[after - 1], self.times[after]
        span = end - start
        s = (time - start) / span
        rows = zip(
            self.positions[after - 1], self.positions[after], self.velocities[after - 1], self.velocities[after],
            strict=True,
        )  # fmt: skip
        positions, velocities = [], []
        for p, q, v, w in rows:
            a, b = p - q, span * (v + w)
            cubic, square = 2 * a + b, -3 * a - span * (2 * v + w)
            positions.append(((cubic * s + square) * s + span * v) * s + p)
            velocities.append(((3 * cubic * s + 2 * square) * s + span * v) / span)
        return positions, velocities

    def record(self) -> records.Trajectory:
        """Return the trajectory as a record."""
        return records.Trajectory(
            joints=self.joints,
            times=self.times,
            positions=[number for row in self.positions for number in row],
            velocities=[number for row in self.velocities for number in row],
        )

    @classmethod
    def of_record(cls, record: records.Trajectory) -> Trajectory:
        """Return the trajectory of a record."""
        joints = tuple(record.joints)
        width = len(joints or BASE_COORDINATES)

        def rows(numbers: Sequence[float]) -> tuple[tuple[float, ...], ...]:
            return tuple(tuple(numbers[start : start + width]) for start in range(0, len(numbers), width))

        return cls(joints, tuple(record.times), rows(record.positions), rows(record.velocities))


@dataclass(frozen=True, slots=True)
class BaseFrame:
    """The parts of a base's pose that are constant in a trajectory."""

    height: float  # m
    lean: Quaternion  # orientation of the base at a yaw of 0

    @classmethod
    def of(cls, pose: Pose) -> BaseFrame:
        """Return the frame of a base at a pose in the world."""
        position, orientation = pose
        back = geometry.from_rpy(0.0, 0.0, -geometry.to_rpy(orientation)[2])
        return cls(position[2], geometry.product(back, orientation))

    def pose(self, row: Sequence[float]) -> Pose:
        """Return the pose of the base at x and y in m and yaw in rad."""
        x, y, yaw = row
        return (x, y, self.height), geometry.product(geometry.from_rpy(0.0, 0.0, yaw), self.lean)
