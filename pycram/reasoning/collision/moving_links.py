"""What of a robot some joints move, as it stands: its links, the boxes around them, and which of these could overlap.

It is worked out once for a state of the robot, since there are many queries while the robot stays where it is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.collision.boxes import overlapping_pairs
from pycram.reasoning.kinematics.articulation import Articulation
from pycram.world import carried

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from numpy.typing import NDArray

    from pycram.physics.body import Body
    from pycram.physics.engine import Engine
    from pycram.reasoning.collision.boxes import Boxes
    from pycram.world.object import Object
    from recorder.geometry.urdf import Urdf

_NEIGHBOURS: Final = 3  # joints between links whose limits keep them apart; their hulls overlap


class MovingLinks:
    """Links that joints move, and the others of the same robot.

    Args:
        engine: where it stands.
        body: the engine's side of it.
        robot: the robot.
        boxes: around all its pieces, as it stands there.
        joints: names of the joints that will be moved.
        all_links: check all links, not just those that the joints move.

    Attributes:
        moving: links that are checked.
        joint_counts: how many of the joints each link hangs on.
        positions: values of the joints, rad or m.
        base_pose: of the robot.
        articulation: how the joints move the links.
        boxes: around the links that are checked.
        drivers: (k,) the number of the joint that moves each of these boxes, -1 where none does.
    """

    def __init__(
        self, engine: Engine, body: Body, robot: Object, boxes: Boxes, joints: tuple[str, ...], *, all_links: bool
    ) -> None:
        self.moving = frozenset(robot.links if all_links else carried.moved_links(robot.urdf, joints))
        self.joint_counts = joint_counts(robot.urdf, joints)
        positions = dict(zip(robot.joints, engine.joints(body)[0], strict=True))
        self.positions = {name: positions[name] for name in joints}
        self.base_pose = engine.pose(body)
        self.articulation = Articulation(engine, body, robot.urdf, joints)
        self._all_boxes = boxes
        self._all_drivers = np.array([self.articulation.drivers[link] for link in boxes.links], dtype=np.intp)
        moving = np.array([link in self.moving for link in boxes.links], dtype=bool)
        self.boxes = boxes.subset(moving)
        self.drivers = self._all_drivers[moving]
        names = np.array(boxes.links)
        own = _own_joints(robot.urdf, boxes.links, joints)
        still = np.where(moving, 0, _own_joints(robot.urdf, boxes.links, robot.urdf.movable).T)  # another arm's, say
        apart = moving[:, None] & (np.maximum(own, np.maximum(own.T, still)) > _NEIGHBOURS)
        for link, other in robot.description.may_touch if robot.description else ():
            pair = (names[:, None] == link) & (names == other)
            apart &= ~(pair | pair.T)
        self._pairs = np.nonzero(apart & ~(moving & (names[:, None] >= names)))  # each pair once

    def self_overlaps(self, transforms: NDArray[np.float64]) -> Iterable[tuple[str, str]]:
        """Return pairs of links, the first of which moves, more than a shoulder apart, whose boxes overlap.

        Args:
            transforms: (joints + 1, 4, 4) of the joints, as the articulation has them.
        """
        a, b = self._pairs
        centers, axes = self._all_boxes.moved(transforms[None, self._all_drivers])
        found = overlapping_pairs(centers[0], axes[0], self._all_boxes.half_extents, a, b)
        links = self._all_boxes.links
        return dict.fromkeys((links[a[pair]], links[b[pair]]) for pair in found)


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
