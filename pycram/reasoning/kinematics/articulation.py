"""How links move with joints, for many postures at once: products of exponentials about axes as they stand.

Where the links are in one posture is read from the engine; a joint then carries all that hangs on it about its axis
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
        carriers: for each link the number of the joint that carries it, -1 where none does.
    """

    def __init__(self, engine: Engine, body: Body, urdf: Urdf, joints: Collection[str]) -> None:
        self.joints, self.carriers = _carriers(urdf, joints)
        moving = [urdf.joint(name) for name in self.joints]
        self._parents = [self.carriers[joint.parent] for joint in moving]
        points, orientations = engine.link_frames(body, [joint.child for joint in moving])
        axes = np.array([joint.axis for joint in moving]).reshape(-1, 3)
        axes = np.einsum("jab,jb->ja", geometry.to_matrices(orientations), axes)
        slides = np.array([joint.type == "prismatic" for joint in moving], dtype=bool)
        self._parts = screws.parts_of(axes, points, slides)
        self._now = np.array([engine.joint(body, name) for name in self.joints])

    def moved(self, postures: Sequence[Mapping[str, float]]) -> Array:
        """How joints carry what hangs on them.

        Args:
            postures: joint values in rad or m by name; what isn't named stays.

        Returns:
            (n, joints + 1, 4, 4): for each posture, transforms from where things are to where each joint carries them;
            the last is for what no joint carries.
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
        carried: Array = moved.transpose(1, 0, 2, 3)
        return carried


def _carriers(urdf: Urdf, joints: Collection[str]) -> tuple[tuple[str, ...], dict[str, int]]:
    """Joints in the order of the URDF's links, and for each link the number of the one that carries it."""
    ordered: list[str] = []
    carriers: dict[str, int] = {}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        if joint is not None and joint.name in joints:
            carriers[link] = len(ordered)
            ordered.append(joint.name)
        else:
            carriers[link] = -1 if joint is None else carriers[joint.parent]
    return tuple(ordered), carriers
