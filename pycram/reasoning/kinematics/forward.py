"""Forward kinematics of a chain of joints with a tool at its end, in many postures at once.

Arithmetic on the URDF, no engine. Postures are rows of arrays, a column for each joint that may move.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.store import stored_tree
from pycram.models.warming import notable
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pycram.physics.body import Body
    from pycram.physics.engine import Engine
    from recorder.geometry import Pose
    from recorder.urdf import Joint, Urdf

    Array = NDArray[np.float64]
    Flags = NDArray[np.bool_]


_OPPOSITE: Final = 1e-6  # of half a turn's sine, below which it has no axis
_CACHED: Final = 64


class Chain:
    """A chain of joints.

    Args:
        base_link: the link that poses are given in.
        tool_link: the link at the end.
        joints: names of the joints that may move, in order; others of the chain keep their value.
        fixed: values of those others; 0 by default.
        tool: pose of the tool in the link at the end.
    """

    def __init__(
        self,
        urdf: Urdf,
        base_link: str,
        tool_link: str,
        joints: Sequence[str],
        fixed: Mapping[str, float] | None = None,
        tool: Pose = geometry.IDENTITY,
    ) -> None:
        self.joints = tuple(joints)  # names of those that move
        values = fixed or {}
        moving, befores = [], []
        before = np.eye(4)
        for joint in urdf.chain(base_link, tool_link):
            if joint.name in self.joints:
                befores.append(before @ geometry.pose_matrix(joint.pose(0.0)))
                moving.append(joint)
                before = np.eye(4)
            else:
                before = before @ geometry.pose_matrix(joint.pose(values.get(joint.name, 0.0)))
        self._before = np.array(befores).reshape(-1, 4, 4)
        self._tool = before = before if tool == geometry.IDENTITY else before @ geometry.pose_matrix(tool)
        self._axes = np.array([joint.axis for joint in moving]).reshape(-1, 3)
        slides = np.array([joint.type == "prismatic" for joint in moving], dtype=bool)
        self.sliding = np.flatnonzero(slides).tolist()  # indices of those that slide
        self._parts = self._before[:, None] @ constant_parts(self._axes, np.zeros_like(self._axes), slides)
        lower, upper = (np.array([getattr(joint, end) for joint in moving]) for end in ("lower", "upper"))
        self.bounded = np.isfinite(lower)  # (joints,) which have limits
        self.lower = np.where(self.bounded, lower, -np.pi)  # (joints,) lower limits, rad or m; -pi where there are none
        self.upper = np.where(self.bounded, upper, np.pi)  # (joints,) upper limits, rad or m; pi where there are none
        # where the first joint is, in the base link, m
        self.shoulder: Array = self._before[0, :3, 3] if moving else np.zeros(3)
        links = np.linalg.norm(self._before[1:, :3, 3], axis=1).sum() + np.linalg.norm(before[:3, 3])
        # m from there that the tool is away at most
        self.length = float(links + np.maximum(np.abs(self.lower), np.abs(self.upper))[self.sliding].sum())

    def poses(self, postures: Array) -> Array:
        """Return poses (n, 4, 4) of the tool in the base link for postures (n, joints)."""
        poses: Array = self._transforms(postures)[-1] @ self._tool
        return poses

    def frames(self, postures: Array) -> Array:
        """Return frames (joints, n, 4, 4) behind the joints in the base link for postures (n, joints)."""
        return self._transforms(postures)[1:]

    def at_zero(self) -> tuple[Array, Array, Array]:
        """Return for joints at zero points (joints, 3) of axes, axes (joints, 3), and the pose of the tool."""
        poses, axes = self._frames(np.zeros((1, len(self.joints))))
        return poses[:, 0, :3, 3], axes[0].T, poses[-1, 0] @ self._tool

    def forward(self, postures: Array) -> tuple[Array, Array]:
        """Return the pose of the tool, and the Jacobian.

        Args:
            postures: (n, joints).

        Returns:
            Poses (n, 4, 4) of the tool in the base link, and Jacobians (n, 6, joints): linear, then angular.
        """
        poses, axes = self._frames(postures)
        pose = poses[-1] @ self._tool
        lever = pose[:, :3, 3, None] - poses[:, :, :3, 3].transpose(1, 2, 0)
        linear = np.stack(  # the cross product, spelt out: np.cross is ten times slower on arrays this small
            [
                axes[:, 1] * lever[:, 2] - axes[:, 2] * lever[:, 1],
                axes[:, 2] * lever[:, 0] - axes[:, 0] * lever[:, 2],
                axes[:, 0] * lever[:, 1] - axes[:, 1] * lever[:, 0],
            ],
            axis=1,
        )
        for index in self.sliding:
            linear[:, :, index] = axes[:, :, index]
            axes[:, :, index] = 0.0
        return pose, np.concatenate([linear, axes], axis=1)

    def _frames(self, postures: Array) -> tuple[Array, Array]:
        """Return frames (joints, n, 4, 4) behind the joints, and their axes (n, 3, joints)."""
        poses = self.frames(postures)
        return poses, np.einsum("jnab,jb->naj", poses[:, :, :3, :3], self._axes)  # no joint turns its own axis

    def _transforms(self, postures: Array) -> Array:
        """Return poses (joints + 1, n, 4, 4) in the base link: of that itself, and of the frame behind each joint."""
        poses = np.empty((len(self.joints) + 1, len(postures), 4, 4))
        poses[0] = np.eye(4)
        for number, moved in enumerate(transforms(self._parts, postures.T)):
            np.matmul(poses[number], moved, out=poses[number + 1])
        return poses

    def limited(self, postures: Array) -> Array:
        """Return postures (n, joints) brought within the limits; joints without limits, within half a turn."""
        wrapped = (postures + np.pi) % (2 * np.pi) - np.pi
        inside: Array = np.where(self.bounded, np.clip(postures, self.lower, self.upper), wrapped)
        return inside

    def errors(self, postures: Array, goals: Array, turns: Array | None) -> Array:
        """Return how far the tool is from targets.

        Args:
            postures: (n, joints).
            goals: (3,) for all or (n, 3), m, in the base link.
            turns: (3, 3) or (n, 3, 3) orientations; None if any will do.

        Returns:
            (n, 2) in m and rad.
        """
        pose = self.poses(postures)
        errors = np.zeros((len(postures), 2))
        errors[:, 0] = norms(pose[:, :3, 3] - goals)
        if turns is not None:
            errors[:, 1] = norms(rotation_error(pose[:, :3, :3], turns))
        return errors


def rotation_error(now: Array, goal: Array) -> Array:
    """Return rotation vectors (n, 3) that turn orientations (n, 3, 3) into a goal (3, 3) or (n, 3, 3)."""
    difference = (goal @ now.transpose(0, 2, 1)).reshape(-1, 9)  # row by row
    vector = 0.5 * (difference[:, [7, 2, 3]] - difference[:, [5, 6, 1]])
    sine = norms(vector)
    cosine = 0.5 * (difference[:, ::4].sum(axis=1) - 1)
    angle = np.arctan2(sine, cosine)
    # near half a turn the vector vanishes: any axis helps out of there
    flipped = (sine < _OPPOSITE) & (cosine < 0)
    if flipped.any():
        vector[flipped] = np.array([1e-3, 2e-3, 3e-3])
        sine = norms(vector)
    error: Array = vector * (angle / np.maximum(sine, 1e-12))[:, None]
    return error


def norms(vectors: Array) -> Array:
    """Return the norms (n,) of a few vectors (n, d), for which np.linalg.norm takes longer."""
    found: Array = np.sqrt((vectors * vectors).sum(axis=1))
    return found


def constant_parts(axes: Array, points: Array, slides: Flags) -> Array:
    """Return the constant matrices that the transforms of joints are sums of.

    Args:
        axes: (joints, 3) unit vectors.
        points: (joints, 3) on the axes, m.
        slides: (joints,) which of them are prismatic: they slide along their axis instead of turning about it.

    Returns:
        (joints, 4, 4, 4): the matrices for 1, cosine, sine and value.
    """
    x, y, z = axes.T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    square = cross @ cross
    parts = np.zeros((len(axes), 4, 4, 4))
    turns = parts[:, :3, :3]
    turns[..., :3] = np.stack([np.eye(3) + square, -square, cross], axis=1)
    turns[..., 3] = -(turns[..., :3] @ points[:, None, :, None])[..., 0]
    turns[:, 0, :, 3] += points
    parts[slides, :3] = 0.0
    parts[slides, 0, :3, :3] = np.eye(3)
    parts[:, 0, 3, 3] = 1.0
    parts[slides, 3, :3, 3] = axes[slides]
    return parts


def transforms(parts: Array, values: Array) -> Array:
    """Return the transforms of joints.

    Args:
        parts: (joints, 3 or 4, m, m) matrices; without that for the value where no joint slides.
        values: (joints, n), rad or m.

    Returns:
        (joints, n, m, m).
    """
    joints, terms, m, _ = parts.shape
    factors = np.empty((*values.shape, terms))
    factors[..., 0] = 1.0
    np.cos(values, out=factors[..., 1])
    np.sin(values, out=factors[..., 2])
    factors[..., 3:] = values[..., None]
    made: Array = (factors @ parts.reshape(joints, terms, m * m)).reshape(*values.shape, m, m)
    return made


@dataclass(frozen=True, slots=True)
class Drivers:
    """Which joints, of some that will move, move which links."""

    joints: tuple[str, ...]  # their names, parents before their children
    of_links: Mapping[str, int]  # for each link the number of the joint that moves it, -1 where none does
    parents: Sequence[int]  # (joints,) the number of the joint that moves each joint, -1 where none does
    children: Sequence[str]  # (joints,) the link that hangs on each joint
    axes: Array  # (joints, 3) unit vectors in the frames of these
    slides: NDArray[np.bool_]  # (joints,) which are prismatic


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
        self._parts = constant_parts(axes, points, moved.slides)
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
        moved[:-1] = transforms(self._parts, change.T)
        for index, parent in enumerate(self._parents):
            if parent >= 0:
                moved[index] = moved[parent] @ moved[index]
        by_posture: Array = moved.transpose(1, 0, 2, 3)
        return by_posture
