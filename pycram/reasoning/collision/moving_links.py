"""What of a robot some joints move, as it stands: its links and what they hold, boxes around them, which could overlap.

It is worked out once for a state of the robot, since there are many queries while the robot stays where it is; what
doesn't depend on that, once for a model.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.files import stored_tree
from pycram.models.warming import notable
from pycram.reasoning.collision.boxes import concatenate, overlapping_pairs
from pycram.reasoning.kinematics.articulation import Articulation, drivers
from pycram.world import carried

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pycram.physics.body import Body
    from pycram.physics.engine import Engine
    from pycram.reasoning.collision.boxes import Boxes
    from pycram.world.object import Object
    from recorder.geometry.urdf import Urdf

    #: Names of an object and of one of its links.
    Owner = tuple[str, str]

_CACHED: Final = 64
_NEIGHBOURS: Final = 3  # joints between links whose limits keep them apart; their hulls overlap


class MovingLinks:
    """Links that joints move, with what they hold, and the others of the same robot.

    Args:
        engine: where it stands.
        body: the engine's side of it.
        robot: the robot.
        boxes: around all its pieces, as it stands there.
        held: what it holds: object, the robot's link, and the boxes around the object's pieces.
        joints: names of the joints that will be moved.
        all_links: check all links, not just those that the joints move.

    Attributes:
        moving: links that are checked.
        held: names of the objects that they hold.
        joint_counts: how many of the joints each link hangs on.
        positions: values of the joints, rad or m.
        base_pose: of the robot.
        articulation: how the joints move the links.
        boxes: around the links that are checked, and what they hold.
        owners: (k,) whose these boxes are.
        drivers: (k,) the number of the joint that moves each of these boxes, -1 where none does.
    """

    def __init__(
        self,
        engine: Engine,
        body: Body,
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
        self.joint_counts = joint_counts(robot.model.path, joints)
        positions = dict(zip(robot.joints, engine.joints(body)[0], strict=True))
        self.positions = {name: positions[name] for name in joints}
        self.base_pose = engine.pose(body)
        self.articulation = Articulation(engine, body, drivers(robot.model.path, joints))
        swung = [each for other, link, each in held if link in fixed.moving]
        self.held = frozenset(other.name for other, link, _ in held if link in fixed.moving)
        self._all_boxes = concatenate([boxes, *swung])
        self.boxes = self._all_boxes.subset(fixed.checked)
        self._robot, self._structure = robot.name, fixed
        self._swung = fixed.all_drivers >= 0
        self._swung_boxes = self._all_boxes.subset(self._swung)

    def self_overlaps(self, transforms: NDArray[np.float64]) -> list[dict[tuple[Owner, Owner], None]]:
        """Return for each posture links, more than a shoulder apart, whose boxes overlap; the first of a pair moves.

        What a link holds is as far from others as the link is. Where one of the two is held, it comes first.

        Args:
            transforms: (n, joints + 1, 4, 4) of the joints in each posture, as the articulation has them.
        """
        a, b = self._structure.pairs
        found: list[dict[tuple[Owner, Owner], None]] = [{} for _ in transforms]
        if not len(a):
            return found
        centers, axes = (
            np.repeat(each[None], len(transforms), axis=0) for each in (self._all_boxes.centers, self._all_boxes.axes)
        )
        centers[:, self._swung], axes[:, self._swung] = self._swung_boxes.moved(
            transforms[:, self._structure.all_drivers[self._swung]]
        )
        posture, pair = overlapping_pairs(centers, axes, self._all_boxes.half_extents, a, b)
        for number, i, j in zip(posture.tolist(), a[pair].tolist(), b[pair].tolist(), strict=True):
            one, other = self._structure.all_owners[i], self._structure.all_owners[j]
            found[number][(one, other) if other[0] == self._robot else (other, one)] = None
        return found

    def hangs_on(self, link: str, other: str) -> bool:
        """Return whether one link hangs on all joints of another, as on a trunk; each is solid or holds something."""
        own, numbers = self._structure.own, self._structure.numbers
        return not own[numbers[other], numbers[link]]


@dataclass(frozen=True, slots=True)
class _Structure:
    """What of moving links doesn't depend on where the robot is.

    Attributes:
        moving: as of :class:`MovingLinks`.
        owners: the same.
        drivers: the same.
        all_owners: whose all boxes are: of the robot, and of what it holds in links that move.
        all_drivers: the number of the joint that moves each of all boxes, -1 where none does.
        checked: which of all boxes are checked.
        pairs: numbers of boxes, one before the other, that could meet: they aren't neighbours.
        own: (n, n) how many of all joints the one box's link hangs on, but not the other's.
        numbers: of a box of each link.
    """

    moving: frozenset[str]
    owners: Sequence[Owner]
    drivers: NDArray[np.intp]
    all_owners: Sequence[Owner]
    all_drivers: NDArray[np.intp]
    checked: NDArray[np.bool_]
    pairs: tuple[NDArray[np.intp], NDArray[np.intp]]
    own: NDArray[np.intp]
    numbers: Mapping[str, int]


@lru_cache(maxsize=_CACHED)
@notable
def _structure(
    path: Path,
    robot: str,
    robot_links: tuple[str, ...],
    joints: tuple[str, ...],
    all_links: bool,
    held: tuple[tuple[str, str, tuple[str, ...]], ...],
    may_touch: frozenset[frozenset[str]],
) -> _Structure:
    """Return it for the model with a canonical URDF.

    Args:
        path: the model.
        robot: its name.
        robot_links: links that boxes are around.
        joints: names of the joints that will be moved.
        all_links: check all links.
        held: what is held: name, the robot's link, links that boxes are around.
        may_touch: pairs of the robot's links that may overlap.
    """
    urdf = stored_tree(path)
    moving = frozenset(urdf.links if all_links else carried.moved_links(urdf, joints))
    swung = [each for each in held if each[1] in moving]
    owners = [(robot, link) for link in robot_links]
    owners += [(name, link) for name, _, boxes in swung for link in boxes]
    links = [*robot_links, *(link for _, link, boxes in swung for _ in boxes)]  # what is held moves as its link
    of_links = drivers(path, joints).of_links
    all_drivers = np.array([of_links[link] for link in links], dtype=np.intp)
    checked = np.array([link in moving for link in links], dtype=bool)
    names, own_links = np.array(links), np.arange(len(links)) < len(robot_links)
    own = _own_joints(urdf, links, joints)
    every = _own_joints(urdf, links, urdf.movable)
    still = np.where(checked, 0, every.T)  # another arm's, say
    apart = checked[:, None] & (np.maximum(own, np.maximum(own.T, still)) > _NEIGHBOURS)
    for link, other in map(sorted, may_touch):
        pair = ((names[:, None] == link) & (names == other)) & own_links & own_links[:, None]
        apart &= ~(pair | pair.T)
    first, second = np.nonzero(apart & ~(checked & (names[:, None] >= names)))  # each pair once
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


def _own_joints(urdf: Urdf, links: Collection[str], joints: Collection[str]) -> NDArray[np.intp]:
    """Return how many of some joints the one link hangs on, but not the other: (n, n) for n links."""
    columns = {name: number for number, name in enumerate(joints)}
    above: dict[str, NDArray[np.intp]] = {}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        above[link] = np.zeros(len(columns), dtype=np.intp) if joint is None else above[joint.parent].copy()
        if joint is not None and joint.name in columns:
            above[link][columns[joint.name]] = 1
    rows = np.array([above[link] for link in links]).reshape(len(links), len(columns))
    own: NDArray[np.intp] = rows @ (1 - rows.T)
    return own


@lru_cache(maxsize=_CACHED)
@notable
def joint_counts(path: Path, joints: tuple[str, ...]) -> Mapping[str, int]:
    """Return how many of some joints each link hangs on, of the model with a canonical URDF."""
    urdf = stored_tree(path)
    counts: dict[str, int] = {}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        counts[link] = 0 if joint is None else counts[joint.parent] + (joint.name in joints)
    return counts
