"""Planned trajectories, and how their paths were found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pycram.planning import path
from pycram.world.trajectory import Trajectory
from recorder import records

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from pycram.planning.path import Path
    from pycram.planning.timing import Knots

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Planned:
    """A trajectory that a body may follow.

    Attributes:
        trajectory: where the body is to be when.
        search: how its path was found.
    """

    trajectory: Trajectory
    search: records.PathSearch

    @property
    def end(self) -> dict[str, float]:
        """Joint values in rad or m by name at its end; of a base x, y and yaw."""
        return dict(zip(self.trajectory.coordinates, self.trajectory.positions[-1], strict=True))


def trajectory_of(joints: Sequence[str], knots: Knots) -> Trajectory:
    """Return knots as a trajectory of joints, or of a base if there are none."""
    rows = (tuple(map(tuple, values.tolist())) for values in (knots.positions, knots.velocities))
    return Trajectory(tuple(joints), tuple(knots.times.tolist()), *rows)


def search_record(found: Path, checks: int, way_points: Array) -> records.PathSearch:
    """Return the record of how a path was found, with its way points before it was timed."""
    return records.PathSearch(
        planner=found.planner,
        seed=found.seed,
        attempts=found.attempts,
        checks=checks,
        max_checks=path.MAX_CHECKS,
        way_points=way_points.ravel().tolist(),
    )


def given(joints: Sequence[str], knots: Knots, way_points: Array) -> Planned:
    """Return a trajectory along a path that was given, with no search."""
    search = records.PathSearch(planner="given", way_points=way_points.ravel().tolist())
    return Planned(trajectory_of(joints, knots), search)
