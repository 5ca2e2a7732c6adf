"""A thing is a household object: its visible parts, its convex pieces for collision, its mass and friction.

PyBullet turns a concave mesh into its convex hull, so a bowl would be solid, and shows one colour for each mesh. So a
thing consists of several files, and PyCRAM finds the others next to ``X.stl``:

``X.stl``
    The whole body, one watertight mesh, origin at the middle of its bounding box.
``X.collision.obj``
    The same body as convex pieces, with a group ``o part_k`` for each piece. PyBullet reads the file as a compound of
    convex hulls. PyBullet adds a margin of 1 mm to each hull, so the pieces are 1 mm smaller than the body; then things
    rest on their real underside.
``parts/X.NAME.stl`` and ``objects.toml``
    The visible parts in their colours, in the frame of ``X.stl``. ``[X]`` in ``objects.toml`` lists them as
    ``visual = [{ mesh, rgba }, ...]``, with ``mass`` in kg and ``friction``. Each part becomes a ``<visual>`` element.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from make.solids import Solid, block, join

Colour: TypeAlias = tuple[float, float, float]

MARGIN = 0.001
"""Margin in metres that PyBullet adds to a convex hull from a mesh."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A visible piece of a thing in one colour (red, green, blue from 0 to 1)."""

    name: str
    colour: Colour
    solid: Solid


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """A household object.

    Attributes:
        name: Stem of the names of the files.
        mass: Kilograms.
        friction: Lateral friction coefficient. PyBullet multiplies the coefficients of touching bodies; default 0.5.
        solid: The whole body, watertight.
        pieces: Convex pieces for collision, drawn ``MARGIN`` smaller than the body.
        parts: Visible parts.
    """

    name: str
    mass: float
    friction: float
    solid: Solid
    pieces: tuple[Solid, ...]
    parts: tuple[Part, ...]

    def centred(self) -> Thing:
        """The same thing with its origin at the middle of the bounding box of its solid."""
        x, y, z = (float(value) for value in -self.solid.bounds.mean(axis=0))
        return Thing(
            self.name,
            self.mass,
            self.friction,
            self.solid.moved(x, y, z),
            tuple(piece.moved(x, y, z) for piece in self.pieces),
            tuple(Part(part.name, part.colour, part.solid.moved(x, y, z)) for part in self.parts),
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
    """Raised capital letters on the sides -y and +y of a thing, centred on x = 0, z = 0.

    Args:
        text: Capital letters from ``LETTERS``.
        width: Width of the whole word in metres.
        depth: Distance of the two faces from y = 0 in metres; the letters stand out by 0.4 mm.
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
