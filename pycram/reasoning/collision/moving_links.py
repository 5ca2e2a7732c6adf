"""What of a robot some joints move, as it stands: its links and what they hold, boxes around them, which could overlap.

It is worked out once for a state of the robot, since there are many queries while the robot stays where it is.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.collision.boxes import concatenate, overlapping_pairs
from pycram.reasoning.kinematics.articulation import Articulation
from pycram.world import carried

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from pycram.physics.body import Body
    from pycram.physics.engine import Engine
    from pycram.reasoning.collision.boxes import Boxes
    from pycram.world.object import Object
    from recorder.geometry.urdf import Urdf

    #: Names of an object and of one of its links.
    Owner = tuple[str, str]

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
        self.moving = frozenset(robot.links if all_links else carried.moved_links(robot.urdf, joints))
        self.joint_counts = joint_counts(robot.urdf, joints)
        positions = dict(zip(robot.joints, engine.joints(body)[0], strict=True))
        self.positions = {name: positions[name] for name in joints}
        self.base_pose = engine.pose(body)
        self.articulation = Articulation(engine, body, robot.urdf, joints)
        swung = [each for each in held if each[1] in self.moving]
        self.held = frozenset(other.name for other, *_ in swung)
        self._all_boxes = concatenate([boxes, *(each for *_, each in swung)])
        self._robot = robot.name
        self._all_owners: list[Owner] = [(robot.name, link) for link in boxes.links]
        self._all_owners += [(other.name, link) for other, _, each in swung for link in each.links]
        links = [*boxes.links, *(link for _, link, each in swung for _ in each.links)]  # what is held moves as its link
        self._all_drivers = np.array([self.articulation.drivers[link] for link in links], dtype=np.intp)
        moving = np.array([link in self.moving for link in links], dtype=bool)
        self.boxes = self._all_boxes.subset(moving)
        self.owners = list(itertools.compress(self._all_owners, moving))
        self.drivers = self._all_drivers[moving]
        names, own_links = np.array(links), np.arange(len(links)) < len(boxes.links)
        own = _own_joints(robot.urdf, links, joints)
        self._own = every = _own_joints(robot.urdf, links, robot.urdf.movable)
        self._numbers = {link: number for number, link in enumerate(links)}
        still = np.where(moving, 0, every.T)  # another arm's, say
        apart = moving[:, None] & (np.maximum(own, np.maximum(own.T, still)) > _NEIGHBOURS)
        for link, other in robot.description.may_touch if robot.description else ():
            pair = ((names[:, None] == link) & (names == other)) & own_links & own_links[:, None]
            apart &= ~(pair | pair.T)
        self._pairs = np.nonzero(apart & ~(moving & (names[:, None] >= names)))  # each pair once
        self._swung = self._all_drivers >= 0
        self._swung_boxes = self._all_boxes.subset(self._swung)

    def self_overlaps(self, transforms: NDArray[np.float64]) -> list[dict[tuple[Owner, Owner], None]]:
        """Return for each posture links, more than a shoulder apart, whose boxes overlap; the first of a pair moves.

        What a link holds is as far from others as the link is. Where one of the two is held, it comes first.

        Args:
            transforms: (n, joints + 1, 4, 4) of the joints in each posture, as the articulation has them.
        """
        a, b = self._pairs
        found: list[dict[tuple[Owner, Owner], None]] = [{} for _ in transforms]
        if not len(a):
            return found
        centers, axes = (
            np.repeat(each[None], len(transforms), axis=0) for each in (self._all_boxes.centers, self._all_boxes.axes)
        )
        centers[:, self._swung], axes[:, self._swung] = self._swung_boxes.moved(
            transforms[:, self._all_drivers[self._swung]]
        )
        posture, pair = overlapping_pairs(centers, axes, self._all_boxes.half_extents, a, b)
        for number, i, j in zip(posture.tolist(), a[pair].tolist(), b[pair].tolist(), strict=True):
            one, other = self._all_owners[i], self._all_owners[j]
            found[number][(one, other) if other[0] == self._robot else (other, one)] = None
        return found

    def hangs_on(self, link: str, other: str) -> bool:
        """Return whether one link hangs on all joints of another, as on a trunk; each is solid or holds something."""
        return not self._own[self._numbers[other], self._numbers[link]]


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


def joint_counts(urdf: Urdf, joints: Collection[str]) -> Mapping[str, int]:
    """Return how many of some joints each link of a robot hangs on."""
    counts: dict[str, int] = {}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        counts[link] = 0 if joint is None else counts[joint.parent] + (joint.name in joints)
    return counts
