"""A batch of places that are considered: one query on record, with the map and why each place won't do."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pycram.reasoning.choosing import Choice
from recorder import records
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from pycram.reasoning.places.grid import Grid
    from recorder.geometry import Pose

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Spot:
    """A place that is considered.

    Attributes:
        name: what tells it from others.
        pose: of the base or of the object in the world.
        yaw: rad about the vertical.
        score: 0 to 1.
    """

    name: str
    pose: Pose
    yaw: float
    score: float


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
            grid: the cells.
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
