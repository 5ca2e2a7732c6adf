"""Measures of hands: where fingers are in the tool frame, by the corners of their collision shapes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.visual import pieces_of
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

    from pycram.models.load import Model
    from recorder.geometry import Pose

    Array = NDArray[np.float64]

_PADS: Final = 0.02  # m behind the finger tips in which they take hold


@dataclass(frozen=True, slots=True)
class Jaws:
    """Where two sides of fingers are in a frame whose x points out of the hand and along whose y they close.

    Attributes:
        left: y of the inner face of those on the +y side, m.
        right: y of the inner face of those on the other side, m.
        tip: x of the farthest finger tip, m.
        low: lowest z of the fingers, m.
        high: highest z of the fingers, m.
    """

    left: float
    right: float
    tip: float
    low: float
    high: float

    @property
    def gap(self) -> float:
        """How far they are apart, m."""
        return self.left - self.right


class Corners:
    """Corners of a model's collision shapes, by link."""

    def __init__(self, model: Model) -> None:
        self._urdf = model.urdf
        parts: dict[str, list[Array]] = {}
        for link, corners in pieces_of(model.path):
            parts.setdefault(link, []).append(corners)
        self._corners = {link: np.vstack(pieces) for link, pieces in parts.items()}

    def __contains__(self, link: object) -> bool:
        return link in self._corners

    def of(self, links: Iterable[str], positions: Mapping[str, float], base: str, offset: Pose) -> Array:
        """Return corners (n, 3) of links in a frame.

        Args:
            links: their names; those without a shape have no corners.
            positions: joint values by name, rad or m; 0 for others.
            base: the link that the frame is in.
            offset: its pose there.
        """
        frame = geometry.invert(geometry.multiply(self._urdf.forward_kinematics(positions, base), offset))
        found = [np.zeros((0, 3))]
        for link in links:
            if link in self._corners:
                pose = geometry.multiply(frame, self._urdf.forward_kinematics(positions, link))
                found.append(self._corners[link] @ geometry.to_matrix(pose[1]).T + np.array(pose[0]))
        return np.vstack(found)

    def jaws(self, fingers: Iterable[str], positions: Mapping[str, float], base: str, offset: Pose) -> Jaws | None:
        """Return where fingers are in a frame; None if they aren't on two sides of it. Arguments as for :meth:`of`."""
        found = [corners for finger in fingers if len(corners := self.of([finger], positions, base, offset))]
        tips = [corners[corners[:, 0] >= corners[:, 0].max() - _PADS] for corners in found]
        for seen in (found, tips):  # a jaw that stands still may be part of a palm: its tip is on one side
            sides: tuple[list[Array], list[Array]] = ([], [])
            for corners, part in zip(found, seen, strict=True):
                sides[float(part[:, 1].mean()) < 0.0].append(corners)
            if all(sides):
                break
        else:
            return None
        left, right = (np.vstack(side) for side in sides)
        every = np.vstack([left, right])
        tip = float(every[:, 0].max())
        inner, other = (side[side[:, 0] >= tip - _PADS, 1] for side in (left, right))
        if not len(inner) or not len(other):
            return None
        low, high = float(every[:, 2].min()), float(every[:, 2].max())
        return Jaws(float(inner.min()), float(other.max()), tip, low, high)
