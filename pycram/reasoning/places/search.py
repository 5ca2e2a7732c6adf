"""Places, and what a robot is to reach from one."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pycram.foundation.failures import NoPlace
from pycram.reasoning.choosing import Choice
from recorder import records
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from pycram.reasoning.places.maps import Grid
    from pycram.reasoning.rejections import Rejection
    from recorder.geometry import Pose, Quaternion, Vector

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Place:
    """Where a robot can stand, or an object."""

    position: Vector  # of the robot's base, or of the object, in the world, m
    orientation: Quaternion  # of it, xyzw
    arms: tuple[str, ...] = ()  # that reach from there, or to there; empty if that wasn't asked
    score: float = 1.0  # of the maps, 0 to 1
    surface: str = ""  # name of the surface that it is on; "" for the ground
    # by arm the side from which it takes the object that is to be reached, if one is
    grasps: Mapping[str, str] = field(default_factory=dict)


class ConstraintCounts:
    """Counts of the places that each constraint excluded.

    Args:
        wanted: for what a place is wanted, in words.
    """

    def __init__(self, wanted: str) -> None:
        self._wanted = wanted
        self._counts: dict[str, int] = {}
        self._last = ""

    def product(self, maps: Iterable[tuple[str, Array]]) -> tuple[Array, float]:
        """Return the product (cells,) of maps by their constraints, the best cell 1, and how good that one is.

        All cells are 0 if none is left.
        """
        scores = np.ones(1)
        for constraint, score in maps:
            left = scores.any()
            scores = scores * score
            if left and not scores.any() and not self._counts:
                self._counts[constraint], self._last = len(scores), constraint
        best = float(scores.max())
        return scores / (best or 1.0), best

    def exclude(self, batch: Batch, spot: Spot, constraint: str, reason: Rejection) -> None:
        """Say that a constraint excludes a place, and why."""
        batch.reject(spot.name, reason)
        self._counts[constraint] = self._counts.get(constraint, 0) + 1
        self._last = constraint

    def failure(self) -> NoPlace:
        """Return the failure that says so."""
        return NoPlace(self._wanted, self._counts, self._last)


@dataclass(frozen=True, slots=True)
class Spot:
    """A place that is considered."""

    name: str  # what tells it from others
    pose: Pose  # of the base or of the object in the world
    yaw: float  # rad about the vertical
    score: float  # 0 to 1


class Batch(Choice):
    """A choice among places that were drawn from a grid.

    Args:
        name: what is asked for.
        arguments: what about, by name.
    """

    __slots__ = ("_drawn",)

    def __init__(self, name: str, arguments: Mapping[str, object]) -> None:
        super().__init__(name, arguments, wanted=journal.recording())
        self._drawn: tuple[Grid, Array, Sequence[Spot]] | None = None

    def draw(self, grid: Grid, scores: Array, spots: Sequence[Spot]) -> Sequence[Spot]:
        """Say what is considered, and return it.

        Args:
            scores: (cells,) of them, 0 to 1.
            spots: those that were drawn, best first.
        """
        self._drawn = grid, scores, spots
        return spots

    def add_candidates(self, record: records.Query) -> Mapping[str, int]:
        """Put the candidates into a record, and the grid."""
        groups = super().add_candidates(record)
        if self._drawn is None:
            return groups
        grid, scores, spots = self._drawn
        shades = np.ceil(np.clip(scores, 0.0, 1.0) * 255).astype(np.uint8)
        height, width = grid.shape
        record.grid.CopyFrom(
            records.Grid(
                origin=grid.origin,
                resolution=grid.resolution,
                width=width,
                height=height,
                scores=zlib.compress(shades.tobytes()),
                spots=[
                    records.Spot(
                        position=spot.pose[0], yaw=spot.yaw, score=spot.score, candidate=groups.get(spot.name, -1)
                    )
                    for spot in spots
                ],
            )
        )
        return groups
