"""Coasting: intervals of simulated time in which bodies follow trajectories without the engine's simulation.

A body that follows its trajectory in free space moves as planned, and all resting bodies stay where they are. If all
other bodies rest, and nothing is near the moving links at both ends of an interval of 1/30 s, the bodies are set to
their positions at its end. The engine's steps would take ten times as long.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pycram.world import attachment, simulation
from pycram.world.object import Object
from recorder import geometry
from recorder.geometry import Pose

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld

    Array = NDArray[np.float64]

_NEAR: Final = 0.005  # minimum distance in m between bodies, plus the distance that a link covers in the interval
_ALONG: Final = 0.05  # maximum distance in m between the boxes of two moving links that may move together
_RIGID: Final = (5e-3, 5e-2)  # largest relative motion in m and rad of links that move together


class Coasting:
    """Decides whether those bodies of a world that follow trajectories may coast."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._detector: simulation.RestDetector | None = None
        self._state: tuple[object, ...] = ()  # state of the world after the last interval
        self._following: Sequence[tuple[Object, Sequence[str]]] = ()
        self._furniture: Sequence[Object] = ()  # furniture that follows trajectories
        self._rows: list[tuple[Object, str]] = []  # the moving links
        self._columns: list[tuple[Object, str]] = []  # all links
        self._numbers: list[int] = []  # indices of the moving links among all links
        self._possible: NDArray[np.bool_] = np.zeros((0, 0), bool)  # pairs (moving link, link) that may collide
        self._boxes = np.zeros((0, 2, 3))  # bounds of all links, m
        self._before = np.zeros((0, 2, 3))  # bounds of the moving links at the start of the interval, m
        self._along: dict[tuple[int, int], Pose] = {}  # relative poses at the start of moving links near each other
        self._clear = np.zeros(0)  # distances in m between moving and other links at the end of the last interval
        self._is_clear = False  # whether the moving links had a free space at the end of the last interval

    def may_begin(self, following: Sequence[tuple[Object, Sequence[str]]]) -> bool:
        """Return whether all other bodies rest, and nothing is near the moving links at the start of an interval.

        Args:
            following: The bodies that follow trajectories, and the moving joints of each; no joints for a base.
        """
        furniture = [body for body, _ in following if not body.is_robot]
        if list(following) != self._following:
            self._following, self._rows = list(following), []
        if self._detector is None or self._state != self._present():
            self._detector, self._rows = simulation.RestDetector(self._world, furniture), []
        elif furniture != self._furniture:  # a body that has coasted to the end of its trajectory is at rest
            self._detector.ignore(furniture, stopped=self._is_clear)
        self._furniture = furniture
        if not self._detector.sample():
            self._rows = []
            return False
        if not self._rows:
            self._find_pairs()
            self._is_clear = False
        if not self._is_clear:
            self._before = self._moving_boxes()
            self._along = self._pairs_along()
            self._clear = np.full(len(self._rows), _NEAR)
            self._is_clear = not self._is_near(self._before, self._clear)
        return self._is_clear

    def may_end(self) -> bool:
        """Return whether nothing is near the moving links at the end of an interval, after they were moved there."""
        after = self._moving_boxes()
        way = np.abs(after - self._before).max(axis=(1, 2), initial=0.0)
        if len({body for body, _ in self._following}) == 1:  # both distances have a larger sum than the way
            way = np.maximum(way / 2, way - self._clear)
        self._clear = way + _NEAR
        self._is_clear = not self._is_near(after, self._clear)
        self._before = after
        if self._is_clear:
            self._state = self._present()
        return self._is_clear

    def simulated(self) -> None:
        """Store the state of the world after an interval that the engine simulated."""
        self._state, self._rows = self._present(), []

    def _present(self) -> tuple[object, ...]:
        """Return the state of the world, without the poses of carried objects."""
        world = self._world
        return (
            *world.gravity,
            *(
                (body, *body.attachments.values(), None if body.carrier else world.engine.snapshot(body.handle))
                for body in world.objects
            ),
        )

    def _find_pairs(self) -> None:
        engine, objects = self._world.engine, self._world.objects
        self._columns = [(body, link) for body in objects for link in body.links]
        self._boxes = np.array([engine.box(body.handle, link) for body, link in self._columns]).reshape(-1, 2, 3)
        has_shape = np.ptp(self._boxes, axis=1).max(axis=1) > 0.0
        moved: dict[tuple[Object, str], bool] = {}  # moving links, and whether a base moves each of them
        for body, joints in self._following:
            moved |= dict.fromkeys(_moving(body, joints), not joints)
        self._rows = [each for each, shaped in zip(self._columns, has_shape, strict=True) if shaped and each in moved]
        numbers = {each: number for number, each in enumerate(self._columns)}
        self._numbers = [numbers[each] for each in self._rows]
        roots = {body: attachment.root_of(body) for body in objects}
        turning = {body: {*attachment.moved_links(body.urdf, body.urdf.movable)} for body in objects}
        still = [body.is_environment and link not in turning[body] for body, link in self._columns]
        others = np.array([[roots[body] is not roots[other] for other, _ in self._columns] for body, _ in self._rows])
        driving = np.array([moved[each] for each in self._rows])  # paths of bases were checked before
        self._possible = others.reshape(-1, len(self._columns)) & has_shape & ~(driving[:, None] & np.array(still))

    def _moving_boxes(self) -> Array:
        engine = self._world.engine
        boxes = np.array([engine.box(body.handle, link) for body, link in self._rows]).reshape(-1, 2, 3)
        self._boxes[self._numbers] = boxes
        return boxes

    def _overlap(self, rows: Array, distances: Array) -> NDArray[np.bool_]:
        """Return which pairs of a moving link and a link have boxes nearer to each other than a distance in m."""
        overlap = self._possible.copy()
        low, high = rows[:, 0] - distances[:, None], rows[:, 1] + distances[:, None]
        for axis in range(3):
            overlap &= low[:, axis, None] <= self._boxes[:, 1, axis]
            overlap &= self._boxes[:, 0, axis] <= high[:, axis, None]
        return overlap

    def _is_near(self, rows: Array, distances: Array) -> bool:
        """Return whether a link is nearer to a moving link than a distance in m, and doesn't move along with it."""
        for row, column in np.argwhere(self._overlap(rows, distances)).tolist():
            (body, link), (other, other_link) = self._rows[row], self._columns[column]
            if self._world.engine.link_closest_points(
                body.handle, link, other.handle, float(distances[row]), link_b=other_link
            ) and not self._is_rigid(row, column):
                return True
        return False

    def _pairs_along(self) -> dict[tuple[int, int], Pose]:
        """Return the relative poses of moving links that may move along with each other, like hand and handle."""
        near = np.zeros_like(self._possible)
        near[:, self._numbers] = self._overlap(self._before, np.full(len(self._rows), _ALONG))[:, self._numbers]
        return {(row, column): self._relative(row, column) for row, column in np.argwhere(near).tolist()}

    def _relative(self, row: int, column: int) -> Pose:
        poses = [
            self._world.engine.link_pose(body.handle, link) for body, link in (self._rows[row], self._columns[column])
        ]
        return geometry.multiply(geometry.invert(poses[0]), poses[1])

    def _is_rigid(self, row: int, column: int) -> bool:
        """Return whether two moving links have the same relative pose as at the start."""
        was = self._along.get((row, column))
        if was is None:
            return False
        now = self._relative(row, column)
        return math.dist(was[0], now[0]) < _RIGID[0] and geometry.angle(was[1], now[1]) < _RIGID[1]


def _moving(body: Object, joints: Sequence[str]) -> Iterator[tuple[Object, str]]:
    """Yield the links that a trajectory moves, also of carried objects."""
    links = attachment.moved_links(body.urdf, joints) if joints else body.links
    yield from ((body, link) for link in links)
    for held in body.carried:
        if held.carrier_link in links:
            yield from _moving(held.body, ())
