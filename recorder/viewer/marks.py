"""Marks in the scene: points, lines and arrows with words, in the frame of the world's root."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

import rerun as rr

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.geometry import Vector
    from recorder.viewer.columns import Columns, Moment
    from recorder.viewer.scene import Scene

Color: TypeAlias = "tuple[int, int, int]"
BLUE: Final[Color] = (75, 145, 245)  # all can be read on the viewer's dark ground, and on its light one
GREEN: Final[Color] = (45, 165, 95)
RED: Final[Color] = (242, 82, 72)
YELLOW: Final[Color] = (205, 150, 0)
GREY: Final[Color] = (140, 140, 140)
_DOT: Final = 0.02  # m
_LINE: Final = 0.004


class Marks:
    """Marks of which all go at once.

    Args:
        columns: where they go.
        scene: that they stand in.
    """

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._standing: list[str] = []

    def put(self, world: str, parts: Sequence[str], now: Moment, *shapes: rr.AsComponents) -> None:
        """Makes a mark.

        Args:
            world: name of the world.
            parts: names of the entity, below the world's.
            now: from when on.
            shapes: what is shown.
        """
        path = self._columns.path(world, *parts)
        self._columns.stand(path, self._scene.frame(world))
        self._columns.put(path, now, *shapes)
        self._standing.append(path)

    def clear(self, now: Moment) -> None:
        """Takes all away.

        Args:
            now: from when on.
        """
        for path in self._standing:
            self._columns.clear(path, now)
        self._standing = []


def points(places: Sequence[Vector], color: Color, labels: Sequence[str] = (), radius: float = _DOT) -> rr.AsComponents:
    """Points with words.

    Args:
        places: in m.
        color: of all.
        labels: one each, or none.
        radius: of all in m.
    """
    return rr.Points3D(places, colors=[color], radii=[radius], labels=labels or None)


def line(places: Sequence[Vector], color: Color, radius: float = _LINE) -> rr.AsComponents:
    """A line through places.

    Args:
        places: in m.
        color: of the line.
        radius: in m.
    """
    return rr.LineStrips3D([places], colors=[color], radii=[radius])


def arrow(start: Vector, vector: Vector, color: Color) -> rr.AsComponents:
    """An arrow.

    Args:
        start: where it begins, m.
        vector: where it points to from there, m.
        color: of the arrow.
    """
    return rr.Arrows3D(origins=[start], vectors=[vector], colors=[color], radii=[2 * _LINE])
