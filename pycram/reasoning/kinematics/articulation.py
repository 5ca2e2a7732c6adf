"""How links move with joints, for many postures at once: products of exponentials about axes as they stand.

Where the links are in one posture is read from the engine; a joint then moves all that hangs on it about its axis
(Murray, Li, Sastry: A Mathematical Introduction to Robotic Manipulation, 1994, section 3.2). It doesn't matter what the
other joints are at, or where the robot stands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pycram.reasoning.kinematics import screws
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from pycram.physics.body import Body
    from pycram.physics.engine import Engine
    from recorder.geometry.urdf import Urdf

    Array = NDArray[np.float64]


class Articulation:
    """What some joints move, as a body stands in an engine.

    Args:
        engine: where it stands.
        body: the engine's side of it.
        urdf: its description.
        joints: names of the joints that will move.

    Attributes:
        joints: the same, parents before their children.
        drivers: for each link the number of the joint that moves it, -1 where none does.
    """

    def __init__(self, engine: Engine, body: Body, urdf: Urdf, joints: Collection[str]) -> None:
        self.joints, self.drivers = _drivers(urdf, joints)
        moving = [urdf.joint(name) for name in self.joints]
        self._parents = [self.drivers[joint.parent] for joint in moving]
        points, orientations = engine.link_frames(body, [joint.child for joint in moving])
        axes = np.array([joint.axis for joint in moving]).reshape(-1, 3)
        axes = np.einsum("jab,jb->ja", geometry.to_matrices(orientations), axes)
        slides = np.array([joint.type == "prismatic" for joint in moving], dtype=bool)
        self._parts = screws.constant_parts(axes, points, slides)
        self._now = np.array([engine.joint(body, name) for name in self.joints])

    def transforms(self, postures: Sequence[Mapping[str, float]]) -> Array:
        """Return how joints move what hangs on them.

        Args:
            postures: joint values in rad or m by name; what isn't named stays.

        Returns:
            (n, joints + 1, 4, 4): for each posture, transforms from where things are to where each joint moves them;
            the last is for what no joint moves.
        """
        now = self._now.tolist()
        values = [list(map(posture.get, self.joints, now)) for posture in postures]
        change = np.array(values).reshape(len(postures), len(now)) - self._now
        moved = np.empty((len(now) + 1, len(postures), 4, 4))
        moved[-1] = np.eye(4)
        moved[:-1] = screws.transforms(self._parts, change.T)
        for index, parent in enumerate(self._parents):
            if parent >= 0:
                moved[index] = moved[parent] @ moved[index]
        by_posture: Array = moved.transpose(1, 0, 2, 3)
        return by_posture


def _drivers(urdf: Urdf, joints: Collection[str]) -> tuple[tuple[str, ...], dict[str, int]]:
    """Return joints in the order of the URDF's links, and for each link the number of the one that moves it."""
    ordered: list[str] = []
    drivers: dict[str, int] = {}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        if joint is not None and joint.name in joints:
            drivers[link] = len(ordered)
            ordered.append(joint.name)
        else:
            drivers[link] = -1 if joint is None else drivers[joint.parent]
    return tuple(ordered), drivers
