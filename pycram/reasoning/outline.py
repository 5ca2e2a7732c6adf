"""An object's outline: its surface as rays find it, in a twin where nothing else is.

A gripper has to know how wide an object is where the fingers go, which neither its bounds nor its origin tell: bounds
grow when it turns, and a hollow one has walls.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pycram.reasoning.twin import twin
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pycram.objects import Object
    from recorder.geometry import Pose, Vector


def middle(body: Object) -> Vector:
    """The middle of an object's bounds in the world, m.

    Args:
        body: the object.
    """
    (x0, y0, z0), (x1, y1, z1) = body.get_AABB()
    return (x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2


def half(low: Sequence[float], high: Sequence[float], direction: Sequence[float]) -> float:
    """Half of the size of a box along a direction, m.

    Args:
        low: its lowest corner.
        high: its highest corner.
        direction: a unit vector.
    """
    return sum(abs(d) * (b - a) for d, a, b in zip(direction, low, high, strict=True)) / 2


class Outline:
    """The surface of one object, as it stands.

    Use it with the world's lock held; asking for another object's outline puts this one's object away.

    Attributes:
        low: lowest corner of its bounds in the world, m.
        high: highest corner of its bounds in the world, m.
        middle: the middle of its bounds in the world, m.
    """

    def __init__(self, body: Object) -> None:
        """Puts the object where rays can find it.

        Args:
            body: the object.
        """
        copy = twin(body.world, "outline")
        copy.sync([body])
        self._engine = copy.engine
        self._engine.refresh()  # rays go by bounds, which a new pose alone doesn't move
        low, high = body.get_AABB()
        self.low: Vector = (low[0], low[1], low[2])
        self.high: Vector = (high[0], high[1], high[2])
        self.middle = middle(body)
        self._far = float(np.linalg.norm(np.subtract(high, low))) + 0.05

    def half(self, direction: Sequence[float]) -> float:
        """Half of the size of its bounds along a direction, m.

        Args:
            direction: a unit vector in the world.
        """
        return half(self.low, self.high, direction)

    def across(self, frame: Pose, xs: Sequence[float], zs: Sequence[float]) -> NDArray[np.float64]:
        """How far it extends along the y axis of a frame.

        Args:
            frame: in the world.
            xs: places along the frame's x axis, m.
            zs: places along the frame's z axis, m; of all of them together the farthest count.

        Returns:
            (len(xs), 2), m: lowest and highest y in the frame at each x; nan where there is nothing.
        """
        near = _in_world(frame, [(x, -self._far, z) for x in xs for z in zs])
        far = _in_world(frame, [(x, self._far, z) for x in xs for z in zs])
        shape = (len(xs), len(zs))
        hits = self._engine.rays(np.concatenate([near, far]), np.concatenate([far, near])).reshape(2, *shape)
        lowest = np.where(np.isnan(hits[0]), np.inf, -self._far + hits[0] * 2 * self._far).min(axis=1)
        highest = np.where(np.isnan(hits[1]), -np.inf, self._far - hits[1] * 2 * self._far).max(axis=1)
        found = np.stack([lowest, highest], axis=1)
        found[~np.isfinite(found).all(axis=1)] = np.nan
        return found

    def wall(self, frame: Pose, ys: Sequence[float], zs: Sequence[float]) -> NDArray[np.float64]:
        """Where the wall of something hollow is, looked for from the origin of a frame along its x axis.

        Args:
            frame: in the world; its origin lies inside of the hollow.
            ys: places along the frame's y axis, m; of all of them together the farthest count.
            zs: places along the frame's z axis, m.

        Returns:
            (len(zs), 2), m: x of the wall's inside and outside at each z; inside is nan where it isn't hollow, both
            where there is nothing.
        """
        inner = _in_world(frame, [(0.0, y, z) for z in zs for y in ys])
        outer = _in_world(frame, [(self._far, y, z) for z in zs for y in ys])
        shape = (len(zs), len(ys))
        hits = self._engine.rays(np.concatenate([inner, outer]), np.concatenate([outer, inner])).reshape(2, *shape)
        inside = (hits[0] * self._far).min(axis=1)  # nan where any ray begins within the solid
        outside = np.where(np.isnan(hits[1]), -np.inf, self._far - hits[1] * self._far).max(axis=1)
        return np.stack([inside, np.where(np.isfinite(outside), outside, np.nan)], axis=1)


def _in_world(frame: Pose, points: Sequence[Vector]) -> NDArray[np.float64]:
    """Points (n, 3) of a frame in the world."""
    position, turn = frame
    moved: NDArray[np.float64] = np.array(points) @ geometry.to_matrix(turn).T + np.asarray(position)
    return moved
