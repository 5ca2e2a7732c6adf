"""A thing is a household object: its visible parts, its convex pieces for collision, its mass and friction.

``X.stl`` has the whole body, with its origin at the middle of its bounding box. PyBullet makes concave meshes convex,
so ``X.collision.obj`` has the body as convex pieces. PyBullet adds a margin of 1 mm to each piece, so the pieces are
1 mm smaller than the body. PyBullet shows one colour for each mesh, so the coloured parts are ``parts/X.NAME.stl``; the
table ``[X]`` of ``objects.toml`` lists these parts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from make.solids import Solid, block, join

Colour: TypeAlias = tuple[float, float, float]

MARGIN = 0.001  # margin in metres that PyBullet adds to a convex hull from a mesh


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A visible piece of a thing."""

    name: str
    colour: Colour  # red, green, blue from 0 to 1
    solid: Solid


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """A household object."""

    name: str  # stem of the names of the files
    mass: float  # kg
    friction: float  # coefficient of lateral friction; PyBullet multiplies the coefficients of touching bodies
    solid: Solid  # the whole body, watertight
    pieces: tuple[Solid, ...]  # convex pieces for collision, ``MARGIN`` smaller than the body
    parts: tuple[Part, ...]

    def centred(self) -> Thing:
        """The same thing with its origin at the middle of the bounding box of its solid."""
        middle = [float(value) for value in -self.solid.bounds.mean(axis=0)]
        return replace(
            self,
            solid=self.solid.moved(*middle),
            pieces=tuple(piece.moved(*middle) for piece in self.pieces),
            parts=tuple(replace(part, solid=part.solid.moved(*middle)) for part in self.parts),
        )


LETTERS = {
    "A": ("01110", "10001", "11111", "10001", "10001"),
    "C": ("01111", "10000", "10000", "10000", "01111"),
    "E": ("11111", "10000", "11110", "10000", "11111"),
    "I": ("11111", "00100", "00100", "00100", "11111"),
    "K": ("10001", "10010", "11100", "10010", "10001"),
    "L": ("10000", "10000", "10000", "10000", "11111"),
    "M": ("10001", "11011", "10101", "10001", "10001"),
    "R": ("11110", "10001", "11110", "10010", "10001"),
}


def lettering(text: str, width: float, depth: float) -> Solid:
    """Letters from ``LETTERS`` on the sides -y and +y of a thing, centred on x = 0, z = 0, raised by 0.4 mm.

    ``width`` is the width of the whole word, and ``depth`` is the distance of both sides from y = 0, metres.
    """
    columns = 6 * len(text) - 1
    dot = width / columns
    runs = []
    for place, letter in enumerate(text):
        for row, line in enumerate(LETTERS[letter]):
            start = 0
            while (first := line.find("1", start)) >= 0:
                start = (line + "0").find("0", first)
                x0, x1 = ((6 * place + edge) * dot - width / 2 for edge in (first, start))
                runs.append(block((x0, x1), (-depth - 0.0004, -depth + 0.001), ((1.5 - row) * dot, (2.5 - row) * dot)))
    front = join(runs)
    return join([front, front.turned("z", np.pi)])
