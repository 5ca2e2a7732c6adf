"""What could be in a robot's way, where it stands: boxes around it, balls inside of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pycram.reasoning.collision import boxes, inscribed_spheres

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pycram.reasoning.collision.boxes import Boxes
    from pycram.reasoning.collision.inscribed_spheres import InscribedSpheres
    from pycram.world.object import Object

    Array = NDArray[np.float64]
    Indices = NDArray[np.intp]


class Surroundings:
    """Objects that stay while a robot moves.

    Args:
        objects: the objects.
        parts: boxes around each of them.

    Attributes:
        boxes: (k boxes) around them all.
        whose: of each box the object.
        loose: (k,) flags, which boxes are around things that don't stay where they are put.
    """

    def __init__(self, objects: Sequence[Object], parts: Sequence[Boxes]) -> None:
        self._objects = objects
        self.boxes = boxes.together(parts)
        counts = np.array([len(part.links) for part in parts], dtype=np.intp)
        self._firsts = np.cumsum(counts) - counts  # box of each object
        self._numbers = np.repeat(np.arange(len(counts)), counts)
        self.whose = [objects[number] for number in self._numbers.tolist()]
        self.loose = np.repeat(np.array([not other.fixed for other in objects], dtype=bool), counts)

    def overlaps(self, balls: InscribedSpheres, centers: Array, axes: Array, others: Indices) -> Array:
        """How deep balls in n boxes beside some of these are in what is in them, at least.

        Args:
            balls: in n boxes.
            centers: (n, 3) of these boxes in the world, m.
            axes: (n, 3, 3) of these boxes.
            others: (n,) numbers of the boxes beside them.

        Returns:
            (n,), m; negative where nothing is known.
        """
        back = self.boxes.axes[others].transpose(0, 2, 1)
        ways = (back @ (centers - self.boxes.centers[others])[:, :, None])[:, :, 0]
        return balls.overlaps(back @ axes, ways, self._balls(others))

    def _balls(self, others: Indices) -> InscribedSpheres:
        """Those inside of some boxes; asked for only of the objects that these are around."""
        numbers = self._numbers[others]
        shift = np.zeros(len(self._objects), dtype=np.intp)  # from a box's number to that of its balls
        found: list[InscribedSpheres] = []
        for number in sorted(set(numbers.tolist())):
            shift[number] = sum(len(mine.radii) for mine in found) - self._firsts[number]
            found.append(inscribed_spheres.inscribed_spheres(self._objects[number].model.path))
        return inscribed_spheres.together(found).of(others + shift[numbers])
