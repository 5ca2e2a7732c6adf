"""How links move with joints, for many postures at once: products of exponentials about axes as they stand.

Where the links are in one posture is read from the engine; a joint then carries all that hangs on it about its axis
(Murray, Li, Sastry: A Mathematical Introduction to Robotic Manipulation, 1994, section 3.2). It doesn't matter what the
other joints are at, or where the robot stands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from pycram.body import Body
    from pycram.engine import Engine
    from recorder.urdf import Urdf

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
        x, y, z = axes.T
        zero = np.zeros_like(x)
        cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
        slides = np.array([joint.type == "prismatic" for joint in moving], dtype=bool)
        # what stays as it is, and what the sine of a change, its cosine, and the change itself bring along
        square = cross @ cross
        self._parts = np.zeros((4, len(moving), 4, 4))
        self._parts[:3, :, :3, :3] = np.where(slides[:, None, None], 0.0, [np.eye(3) + square, cross, -square])
        self._parts[:3, :, :3, 3] = -(self._parts[:3, :, :3, :3] @ points[:, :, None])[..., 0]
        self._parts[0, :, :3, 3] += points
        self._parts[0, slides] = np.eye(4)
        self._parts[0, :, 3, 3] = 1.0
        self._parts[3, :, :3, 3] = np.where(slides[:, None], axes, 0.0)
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
        change = (np.array(values).reshape(len(postures), len(now)) - self._now)[:, :, None, None]
        still, aside, beside, along = self._parts
        moved = np.empty((len(postures), len(now) + 1, 4, 4))
        moved[:, -1] = np.eye(4)
        moved[:, :-1] = still + np.sin(change) * aside + np.cos(change) * beside + change * along
        for index, parent in enumerate(self._parents):
            if parent >= 0:
                moved[:, index] = moved[:, parent] @ moved[:, index]
        return moved


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
