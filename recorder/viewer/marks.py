"""Marks in the scene, in the frame of the world's root: points, lines and arrows that are cleared together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

import rerun as rr

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.geometry import Vector
    from recorder.viewer.columns import Columns, TimePoint
    from recorder.viewer.scene import Scene

    Color: TypeAlias = tuple[int, int, int]

BLUE: Final[Color] = (75, 145, 245)  # all can be read on the viewer's dark ground, and on its light one
GREEN: Final[Color] = (45, 165, 95)
RED: Final[Color] = (242, 82, 72)
YELLOW: Final[Color] = (205, 150, 0)
GREY: Final[Color] = (140, 140, 140)

_POINT: Final = 0.02  # m, as all lengths below
_LINE: Final = 0.004
_ARROW: Final = 0.008


class Marks:
    """Marks that are cleared together."""

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._paths: list[str] = []

    def add(self, world: str, parts: Sequence[str], now: TimePoint, *shapes: rr.AsComponents) -> None:
        """Shows shapes from now on, as the entity of these names below the world's."""
        path = self._columns.path(world, *parts)
        self._columns.set_frame(path, self._scene.frame(world))
        self._columns.send(path, now, *shapes)
        self._paths.append(path)

    def clear(self, now: TimePoint) -> None:
        """Removes all marks."""
        for path in self._paths:
            self._columns.clear(path, now)
        self._paths = []


def points(
    positions: Sequence[Vector], color: Color, labels: Sequence[str] = (), radius: float = _POINT
) -> rr.AsComponents:
    """Points in m, each with its label if there are any; radius in m."""
    return rr.Points3D(positions, colors=[color], radii=[radius], labels=labels or None)


def line(positions: Sequence[Vector], color: Color, radius: float = _LINE) -> rr.AsComponents:
    """A line through positions in m; radius in m."""
    return rr.LineStrips3D([positions], colors=[color], radii=[radius])


def arrow(start: Vector, vector: Vector, color: Color) -> rr.AsComponents:
    """An arrow from a position along a vector, both in m."""
    return rr.Arrows3D(origins=[start], vectors=[vector], colors=[color], radii=[_ARROW])
