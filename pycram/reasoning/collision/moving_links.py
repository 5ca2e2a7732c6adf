"""What of a robot some joints move, as it stands: its links, the boxes around them, and which of these could meet.

It is worked out once for a state of the robot, since many questions are asked while the robot stays where it is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.collision.boxes import overlapping
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

_BESIDE: Final = 3  # joints between links whose limits keep them apart; their hulls overlap


class MovingLinks:
    """Links that joints move, and the others of the same robot.

    Args:
        engine: where it stands.
        copy: the engine's side of it.
        robot: the robot.
        boxes: around all its pieces, as it stands there.
        joints: names of the joints that will be moved.
        everything: look at all links, not just those that the joints move.

    Attributes:
        moving: links that are looked at.
        depth: how many of the joints each link hangs on.
        now: values of the joints, rad or m.
        stand: pose of its base.
        articulation: how the joints move them.
        boxes: around the links that are looked at.
        carriers: (k,) the number of the joint that carries each box, -1 where none does.
    """

    def __init__(
        self, engine: Engine, copy: Body, robot: Object, boxes: Boxes, joints: tuple[str, ...], *, everything: bool
    ) -> None:
        self.moving = frozenset(robot.links if everything else carried.moved_links(robot.urdf, joints))
        self.depth = arm_depths(robot.urdf, joints)
        now = dict(zip(robot.joints, engine.joints(copy)[0], strict=True))
        self.now = {name: now[name] for name in joints}
        self.stand = engine.pose(copy)
        self.articulation = Articulation(engine, copy, robot.urdf, joints)
        self._whole = boxes
        carriers = self.articulation.carriers
        self._carriers = np.array([carriers[link] for link in boxes.links], dtype=np.intp)
        moving = np.array([link in self.moving for link in boxes.links], dtype=bool)
        self.boxes = boxes.chosen(moving)
        self.carriers = self._carriers[moving]
        depths = np.array([self.depth[link] for link in boxes.links])
        names = np.array(boxes.links)
        told = moving[:, None] & (np.abs(depths[:, None] - depths) > _BESIDE)
        self._pairs = np.nonzero(told & ~(moving & (names[:, None] >= names)))  # each pair once

    def meeting(self, moved: NDArray[np.float64]) -> Iterable[tuple[str, str]]:
        """Pairs of links, the first of which moves, more than a shoulder apart, whose boxes meet; each once.

        Args:
            moved: (joints + 1, 4, 4) how the joints carry things, as the articulation says.
        """
        firsts, seconds = self._pairs
        centers, axes = self._whole.carried(moved[None, self._carriers])
        met = overlapping(centers[0], axes[0], self._whole.halves, firsts, seconds)
        links = self._whole.links
        return dict.fromkeys((links[firsts[pair]], links[seconds[pair]]) for pair in met)


def arm_depths(urdf: Urdf, joints: Collection[str]) -> Mapping[str, int]:
    """How many of some joints each link hangs on.

    Args:
        urdf: of the robot.
        joints: their names.
    """
    depth: dict[str, int] = {}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        depth[link] = 0 if joint is None else depth[joint.parent] + (joint.name in joints)
    return depth
