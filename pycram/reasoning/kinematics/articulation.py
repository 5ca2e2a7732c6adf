"""How links move with joints, for many postures at once: products of exponentials about axes as they stand.

Where the links are in one posture is read from the engine; a joint then moves all that hangs on it about its axis
(Murray, Li, Sastry: A Mathematical Introduction to Robotic Manipulation, 1994, section 3.2). It doesn't matter what the
other joints are at, or where the robot stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.files import stored_tree
from pycram.models.warming import notable
from pycram.reasoning.kinematics import screws
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pycram.physics.body import Body
    from pycram.physics.engine import Engine
    from recorder.geometry.urdf import Joint

    Array = NDArray[np.float64]

_CACHED: Final = 64


@dataclass(frozen=True, slots=True)
class Drivers:
    """Which joints, of some that will move, move which links.

    Attributes:
        joints: their names, parents before their children.
        of_links: for each link the number of the joint that moves it, -1 where none does.
        parents: (joints,) the number of the joint that moves each joint, -1 where none does.
        children: (joints,) the link that hangs on each joint.
        axes: (joints, 3) unit vectors in the frames of these.
        slides: (joints,) which are prismatic.
    """

    joints: tuple[str, ...]
    of_links: Mapping[str, int]
    parents: Sequence[int]
    children: Sequence[str]
    axes: Array
    slides: NDArray[np.bool_]


@lru_cache(maxsize=_CACHED)
@notable
def drivers(path: Path, joints: tuple[str, ...]) -> Drivers:
    """Return which of some joints of a model with a canonical URDF move which links."""
    urdf = stored_tree(path)
    moving: list[Joint] = []
    of_links: dict[str, int] = {}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        if joint is not None and joint.name in joints:
            of_links[link] = len(moving)
            moving.append(joint)
        else:
            of_links[link] = -1 if joint is None else of_links[joint.parent]
    return Drivers(
        joints=tuple(joint.name for joint in moving),
        of_links=of_links,
        parents=[of_links[joint.parent] for joint in moving],
        children=[joint.child for joint in moving],
        axes=np.array([joint.axis for joint in moving]).reshape(-1, 3),
        slides=np.array([joint.type == "prismatic" for joint in moving], dtype=bool),
    )


class Articulation:
    """What some joints move, as a body stands in an engine.

    Args:
        engine: where it stands.
        body: the engine's side of it.
        moved: the joints that will move.
    """

    def __init__(self, engine: Engine, body: Body, moved: Drivers) -> None:
        self._joints, self._parents = moved.joints, moved.parents
        points, orientations = engine.link_frames(body, moved.children)
        axes = np.einsum("jab,jb->ja", geometry.to_matrices(orientations), moved.axes)
        self._parts = screws.constant_parts(axes, points, moved.slides)
        positions = dict(zip(body.joints, engine.joints(body)[0], strict=True))
        self._now = np.array([positions[name] for name in moved.joints])

    def transforms(self, postures: Sequence[Mapping[str, float]]) -> Array:
        """Return how joints move what hangs on them.

        Args:
            postures: joint values in rad or m by name; what isn't named stays.

        Returns:
            (n, joints + 1, 4, 4): for each posture, transforms from where things are to where each joint moves them;
            the last is for what no joint moves.
        """
        now = self._now.tolist()
        values = [list(map(posture.get, self._joints, now)) for posture in postures]
        change = np.array(values).reshape(len(postures), len(now)) - self._now
        moved = np.empty((len(now) + 1, len(postures), 4, 4))
        moved[-1] = np.eye(4)
        moved[:-1] = screws.transforms(self._parts, change.T)
        for index, parent in enumerate(self._parents):
            if parent >= 0:
                moved[index] = moved[parent] @ moved[index]
        by_posture: Array = moved.transpose(1, 0, 2, 3)
        return by_posture
