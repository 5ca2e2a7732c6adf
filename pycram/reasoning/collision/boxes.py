"""Oriented bounding boxes around the convex pieces of bodies, and their overlaps: the broad phase of collision checks.

An overlap test first compares the boxes' bounds along the world's axes, then uses separating axes (Gottschalk, Lin and
Manocha, OBBTree, SIGGRAPH 1996). If two boxes don't overlap, their pieces don't touch.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models import shapes
from pycram.models.store import stored_tree
from pycram.reasoning.kinematics.forward import Articulation, drivers
from pycram.world import attachment
from recorder import geometry
from recorder.geometry import Array, Flags, Indices, Pose
from recorder.urdf import Urdf

if TYPE_CHECKING:
    from pycram.world.object import Object

    Owner = tuple[str, str]

_MARGIN: Final = 1.5e-3  # margin in m on each side of a box, because the engine pads shapes by 1 mm
_PARALLEL: Final = 1e-5  # number added to cosines, because cross products of parallel edges are zero, up to rounding
_MAX_BOXES: Final = 8  # maximum number of boxes of a link; with more pieces, as in a bowl, a link has one box
_CORNERS: Final = np.array(list(itertools.product((0.0, 1.0), repeat=3)))  # corners of a box as shares of its edges

# Indices for the cross products of edge i of a box and edge j of another box; the product has the number 3 * i + j.
# k and l are the axes after i, m and n the axes after j. _SIZES and _COSINES select the sizes and cosines of the four
# terms of the boxes' extents along a product.
_I, _J = np.divmod(np.arange(9), 3)
_K, _L, _M, _N = (_I + 1) % 3, (_I + 2) % 3, (_J + 1) % 3, (_J + 2) % 3
_KJ, _LJ = 3 * _K + _J, 3 * _L + _J
_SIZES: Final = np.concatenate([_K, _L, 3 + _M, 3 + _N])
_COSINES: Final = np.concatenate([_LJ, _KJ, 3 * _I + _N, 3 * _I + _M])
_CACHED: Final = 64
_NEIGHBOURS: Final = 3  # maximum number of joints between neighbours, whose hulls may always overlap


@dataclass(frozen=True, eq=False)
class Boxes:
    """k oriented boxes. Sets of boxes are compared by identity."""

    links: tuple[str, ...]  # (k,) names of the links in the boxes
    centers: Array  # (k, 3) centers in the world, m
    axes: Array  # (k, 3, 3) unit axes in the world, as columns
    half_extents: Array  # (k, 3) half extents along the axes, m

    @classmethod
    def around(cls, body: Object) -> Boxes:
        """Return the boxes of an object at its pose in its world."""
        names, low, high = _bounds(body.model.path)
        positions, orientations = body.world.engine.link_frames(body.handle, names)
        axes = geometry.to_matrices(orientations)
        centers = np.einsum("kij,kj->ki", axes, (low + high) / 2) + positions
        return cls(names, centers, axes, (high - low) / 2 + _MARGIN)

    @cached_property
    def ends(self) -> tuple[Array, Array]:
        """Lowest and highest corners (k, 3) of the boxes' bounds along the world's axes, m."""
        extents = _world_extents(self.axes, self.half_extents)
        return self.centers - extents, self.centers + extents

    def subset(self, which: Flags) -> Boxes:
        """Return the boxes whose flags (k,) are true."""
        links = tuple(link for link, wanted in zip(self.links, which, strict=True) if wanted)
        return Boxes(links, self.centers[which], self.axes[which], self.half_extents[which])

    def widened(self, margin: float) -> Boxes:
        """Return boxes that are wider on each side by a margin in m."""
        return Boxes(self.links, self.centers, self.axes, self.half_extents + margin)

    @classmethod
    def swept(cls, path: Path, poses: Mapping[str, Sequence[Pose]]) -> Boxes:
        """Return boxes, along the axes of a frame, around the space that the pieces of links sweep between poses.

        Between two poses of a link in the frame, a straight line must be exact to 1 mm.
        """
        names, low, high = _bounds(path)
        kept = [number for number, name in enumerate(names) if name in poses]
        ends = np.empty((len(kept), 2, 3))
        for row, number in enumerate(kept):
            frames = np.array([geometry.pose_matrix(pose) for pose in poses[names[number]]])
            corners = _CORNERS * (high[number] - low[number]) + low[number]
            swept = corners @ frames[:, :3, :3].transpose(0, 2, 1) + frames[:, None, :3, 3]
            ends[row] = swept.min(axis=(0, 1)), swept.max(axis=(0, 1))
        axes = np.repeat(np.eye(3)[None], len(kept), axis=0)
        links = tuple(names[number] for number in kept)
        return cls(links, ends.mean(axis=1), axes, (ends[:, 1] - ends[:, 0]) / 2 + _MARGIN)

    def placed(self, pose: Pose) -> Boxes:
        """Return the boxes after a motion of their frame to a pose."""
        centers, axes = self.moved(geometry.pose_matrix(pose)[None])
        return Boxes(self.links, centers, axes, self.half_extents)

    def raised(self, up: float) -> Boxes:
        """Return one box along the world's axes: around the space of all boxes when they are lifted by ``up`` m."""
        if not self.links:
            return self
        lows, highs = self.ends
        low, high = lows.min(axis=0), highs.max(axis=0)
        high[2] += up
        return Boxes(self.links[:1], ((low + high) / 2)[None], np.eye(3)[None], ((high - low) / 2)[None])

    def moved(self, transforms: Array) -> tuple[Array, Array]:
        """Return centers (n, k, 3) in m and axes (n, k, 3, 3) of the boxes after transforms (n, k, 4, 4)."""
        turns = transforms[..., :3, :3]
        return (turns @ self.centers[:, :, None])[..., 0] + transforms[..., :3, 3], turns @ self.axes


@lru_cache(maxsize=256)
def _bounds(path: Path) -> tuple[tuple[str, ...], Array, Array]:
    """Return the links of pieces, and their lowest and highest corners (k, 3) in the links' frames."""
    pieces: dict[str, list[shapes.Ends]] = {}
    for link, ends in shapes.piece_bounds(path):
        pieces.setdefault(link, []).append(ends)
    boxes = [
        (link, ends)
        for link, each in pieces.items()
        for ends in (each if len(each) <= _MAX_BOXES else [shapes.bounds(np.array(each))])
    ]
    corners = np.array([ends for _, ends in boxes]).reshape(-1, 2, 3)
    return tuple(link for link, _ in boxes), corners[:, 0], corners[:, 1]


def concatenate(parts: Sequence[Boxes]) -> Boxes:
    """Return the boxes of all parts in order."""
    if not parts:
        return Boxes((), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    return Boxes(
        tuple(itertools.chain.from_iterable(part.links for part in parts)),
        np.concatenate([part.centers for part in parts]),
        np.concatenate([part.axes for part in parts]),
        np.concatenate([part.half_extents for part in parts]),
    )


def _world_extents(axes: Array, half_extents: Array) -> Array:
    """Return half extents (..., 3) along the world's axes in m for boxes with axes (..., 3, 3)."""
    along: Array = np.einsum("...ij,...j->...i", np.abs(axes), half_extents)
    return along


def overlaps(centers: Array, axes: Array, half_extents: Array, others: Boxes) -> tuple[Indices, Indices, Indices]:
    """Return the overlaps between moving boxes and other boxes, for many postures together.

    The k moving boxes have centers (n, k, 3) in the world, m, and axes (n, k, 3, 3) in each posture, and half extents
    (k, 3), m. The result has the indices of postures, moving boxes and other boxes for each overlap, in order.
    """
    extents = _world_extents(axes, half_extents)
    lows, highs = centers - extents, centers + extents
    other_lows, other_highs = others.ends
    low, high = lows.min(axis=(0, 1), initial=np.inf), highs.max(axis=(0, 1), initial=-np.inf)
    near = np.flatnonzero(((other_highs >= low) & (other_lows <= high)).all(axis=1))
    other_lows, other_highs = other_lows[near], other_highs[near]
    overlapping = np.ones((len(centers), centers.shape[1], len(near)), dtype=bool)
    for axis in range(3):
        overlapping &= lows[:, :, None, axis] <= other_highs[:, axis]
        overlapping &= highs[:, :, None, axis] >= other_lows[:, axis]
    posture, box, other = np.nonzero(overlapping)
    other = near[other]
    if not len(posture):
        return posture, box, other
    found = _overlap(
        (centers[posture, box], axes[posture, box], half_extents[box]),
        (others.centers[other], others.axes[other], others.half_extents[other]),
    )
    return posture[found], box[found], other[found]


def overlapping_pairs(
    centers: Array, axes: Array, half_extents: Array, a: Indices, b: Indices
) -> tuple[Indices, Indices]:
    """Return the overlaps among pairs of boxes, for many postures together; see :func:`overlaps` for shapes.

    The boxes ``a`` and ``b`` (m,) are the indices of the first and second boxes of the pairs. The result has the
    indices of postures and of pairs for each overlap, in order.
    """
    sizes = _world_extents(axes, half_extents)
    close = np.ones((len(centers), len(a)), dtype=bool)
    for axis in range(3):
        center, size = centers[:, :, axis], sizes[:, :, axis]
        close &= np.abs(center.take(a, axis=1) - center.take(b, axis=1)) <= size.take(a, axis=1) + size.take(b, axis=1)
    posture, pair = np.nonzero(close)
    if not len(pair):
        return posture, pair
    one, other = a[pair], b[pair]
    found = _overlap(
        (centers[posture, one], axes[posture, one], half_extents[one]),
        (centers[posture, other], axes[posture, other], half_extents[other]),
    )
    return posture[found], pair[found]


def _overlap(a: tuple[Array, Array, Array], b: tuple[Array, Array, Array]) -> Flags:
    """Return whether pairs (n,) of boxes (centers, axes, half extents) overlap, tested with 15 separating axes."""
    (centers, axes, halves), (other_centers, other_axes, other_halves) = a, b
    back = axes.transpose(0, 2, 1)
    turn = back @ other_axes  # axes of the other boxes in the frames of the boxes
    offset = (back @ (other_centers - centers)[:, :, None])[:, :, 0]
    cosines = np.abs(turn) + _PARALLEL
    overlap: Flags = np.all(np.abs(offset) <= halves + (cosines @ other_halves[:, :, None])[:, :, 0], axis=1)
    left = np.flatnonzero(overlap)  # the axes of the first boxes separate most pairs
    turn, offset, cosines, halves, other_halves = (part[left] for part in (turn, offset, cosines, halves, other_halves))
    along = (turn.transpose(0, 2, 1) @ offset[:, :, None])[:, :, 0]
    apart = (np.abs(along) > other_halves + (cosines.transpose(0, 2, 1) @ halves[:, :, None])[:, :, 0]).any(axis=1)
    # cross products of edge i of box a and edge j of box b, in column 3 * i + j
    turn, cosines = turn.reshape(-1, 9), cosines.reshape(-1, 9)
    distance = offset.take(_L, axis=1) * turn.take(_KJ, axis=1)
    distance -= offset.take(_K, axis=1) * turn.take(_LJ, axis=1)
    sizes = np.concatenate([halves, other_halves], axis=1).take(_SIZES, axis=1)
    apart |= (np.abs(distance) > (sizes * cosines.take(_COSINES, axis=1)).reshape(-1, 4, 9).sum(axis=1)).any(axis=1)
    overlap[left[apart]] = False
    return overlap


class MovingLinks:
    """The links of a robot that joints move, with the objects that these links hold.

    ``held`` contains, for each held object, the robot's link that holds it and the boxes around its pieces.
    """

    def __init__(
        self,
        robot: Object,
        boxes: Boxes,
        held: Sequence[tuple[Object, str, Boxes]],
        joints: tuple[str, ...],
        *,
        all_links: bool,
    ) -> None:
        held_links = tuple((other.name, link, each.links) for other, link, each in held)
        may_touch = robot.description.may_touch if robot.description else frozenset()
        fixed = _structure(robot.model.path, robot.name, boxes.links, joints, all_links, held_links, may_touch)
        self.moving, self.owners, self.drivers = fixed.moving, fixed.owners, fixed.drivers
        self.joint_counts = joint_counts(robot.model.path, joints)  # number of moving joints above each link
        engine, body = robot.world.engine, robot.handle
        positions = dict(zip(robot.joints, engine.joints(body)[0], strict=True))
        self.positions = {name: positions[name] for name in joints}  # present positions of the joints, rad or m
        self.base_pose = engine.pose(body)
        self.articulation = Articulation(engine, body, drivers(robot.model.path, joints))  # how joints move the links
        swung = [each for other, link, each in held if link in fixed.moving]
        # names of the objects that moving links hold
        self.held = frozenset(other.name for other, link, _ in held if link in fixed.moving)
        self._all_boxes = concatenate([boxes, *swung])
        self.boxes = self._all_boxes.subset(fixed.checked)  # boxes of the checked links and the objects that they hold
        self._robot, self._structure = robot.name, fixed
        self._swung = fixed.all_drivers >= 0
        self._swung_boxes = self._all_boxes.subset(self._swung)

    def self_overlaps(self, transforms: Array) -> list[dict[tuple[Owner, Owner], None]]:
        """Return, for each posture, the pairs of links with overlapping boxes, except neighbours.

        A held object has the same neighbours as its link. The first of two links moves, or belongs to a held object.
        The transforms (n, joints + 1, 4, 4) of links, for each posture and joint, come from the articulation.
        """
        a, b = self._structure.pairs
        found: list[dict[tuple[Owner, Owner], None]] = [{} for _ in transforms]
        if not len(a):
            return found
        centers = np.repeat(self._all_boxes.centers[None], len(transforms), axis=0)
        axes = np.repeat(self._all_boxes.axes[None], len(transforms), axis=0)
        centers[:, self._swung], axes[:, self._swung] = self._swung_boxes.moved(
            transforms[:, self._structure.all_drivers[self._swung]]
        )
        posture, pair = overlapping_pairs(centers, axes, self._all_boxes.half_extents, a, b)
        for number, i, j in zip(posture.tolist(), a[pair].tolist(), b[pair].tolist(), strict=True):
            one, other = self._structure.all_owners[i], self._structure.all_owners[j]
            found[number][(one, other) if other[0] == self._robot else (other, one)] = None
        return found

    def hangs_on(self, link: str, other: str) -> bool:
        """Return whether all joints above ``other`` are above ``link``; both links have shapes or hold an object."""
        own, numbers = self._structure.own, self._structure.numbers
        return not own[numbers[other], numbers[link]]


@dataclass(frozen=True, slots=True)
class _Structure:
    """Data of moving links that don't depend on the robot's pose."""

    moving: frozenset[str]  # names of the checked links
    owners: Sequence[Owner]  # owner of each checked box: a link, or the link that holds the object
    drivers: Indices  # (k,) index of the joint that moves each checked box; -1 for none
    all_owners: Sequence[Owner]  # owner of each box of the robot and of objects that moving links hold
    all_drivers: Indices  # index of the joint that moves each box; -1 for none
    checked: Flags  # whether each box is checked
    # indices of the first and second boxes of pairs that may touch, in ascending order, without neighbours
    pairs: tuple[Indices, Indices]
    own: Indices  # (n, n) number of joints that move the first box's link but not the second box's link
    numbers: Mapping[str, int]  # index of any one box of each link


@lru_cache(maxsize=_CACHED)
def _structure(
    path: Path,
    robot: str,
    robot_links: tuple[str, ...],
    joints: tuple[str, ...],
    all_links: bool,
    held: tuple[tuple[str, str, tuple[str, ...]], ...],
    may_touch: frozenset[frozenset[str]],
) -> _Structure:
    """Return the structure for a model with a checked URDF; see :class:`MovingLinks`.

    ``held`` contains, for each held object, its name, the robot's link that holds it, and the links of its boxes.
    """
    urdf = stored_tree(path)
    moving = frozenset(urdf.links if all_links else attachment.moved_links(urdf, joints))
    swung = [each for each in held if each[1] in moving]
    owners = [(robot, link) for link in robot_links]
    owners += [(name, link) for name, _, boxes in swung for link in boxes]
    links = [*robot_links, *(link for _, link, boxes in swung for _ in boxes)]  # a held object moves with its link
    of_links = drivers(path, joints).of_links
    all_drivers = np.array([of_links[link] for link in links], dtype=np.intp)
    checked = np.array([link in moving for link in links], dtype=bool)
    names, own_links = np.array(links), np.arange(len(links)) < len(robot_links)
    own = _own_joints(urdf, links, joints)
    every = _own_joints(urdf, links, urdf.movable)
    still = np.where(checked, 0, every.T)  # links that only unchecked joints move, such as links of another arm
    apart = checked[:, None] & (np.maximum(own, np.maximum(own.T, still)) > _NEIGHBOURS)
    for link, other in map(sorted, may_touch):
        pair = ((names[:, None] == link) & (names == other)) & own_links & own_links[:, None]
        apart &= ~(pair | pair.T)
    first, second = np.nonzero(apart & ~(checked & (names[:, None] >= names)))  # each pair is considered once
    return _Structure(
        moving=moving,
        owners=list(itertools.compress(owners, checked)),
        drivers=all_drivers[checked],
        all_owners=owners,
        all_drivers=all_drivers,
        checked=checked,
        pairs=(first, second),
        own=every,
        numbers={link: number for number, link in enumerate(links)},
    )


def _own_joints(urdf: Urdf, links: Collection[str], joints: Collection[str]) -> Indices:
    """Return an array (n, n) for n links: the number of joints above the first link that aren't above the second."""
    columns = {name: number for number, name in enumerate(joints)}
    above: dict[str, Indices] = {}
    for link in urdf.links:  # a parent comes before its children
        joint = urdf.parent_joint(link)
        above[link] = np.zeros(len(columns), dtype=np.intp) if joint is None else above[joint.parent].copy()
        if joint is not None and joint.name in columns:
            above[link][columns[joint.name]] = 1
    rows = np.array([above[link] for link in links]).reshape(len(links), len(columns))
    own: Indices = rows @ (1 - rows.T)
    return own


@lru_cache(maxsize=_CACHED)
def joint_counts(path: Path, joints: tuple[str, ...]) -> Mapping[str, int]:
    """Return the number of moving joints above each link, for a model with a checked URDF."""
    urdf = stored_tree(path)
    counts = _own_joints(urdf, urdf.links, joints)[:, 0]  # the first link is the root, below no joint
    return dict(zip(urdf.links, counts.tolist(), strict=True))
