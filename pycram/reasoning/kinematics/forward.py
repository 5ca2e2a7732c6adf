"""Forward kinematics of chains and trees of joints, for many postures together, from the URDF without the engine.

Postures are rows of arrays, with a column for each moving joint. The transform of a joint is a sum of constant matrices
with the weights 1, cosine, sine and position (Murray, Li, Sastry: A Mathematical Introduction to Robotic Manipulation,
1994, section 2.2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pycram.models.store import stored_tree
from recorder import geometry
from recorder.geometry import Array, Pose
from recorder.urdf import Urdf, UrdfJoint

if TYPE_CHECKING:
    from pycram.physics.body import LoadedBody
    from pycram.physics.engine import Engine

    Flags = NDArray[np.bool_]

_OPPOSITE: Final = 1e-6  # sine of half a turn; a smaller sine gives no axis of the rotation
_CACHED: Final = 64


class Chain:
    """A chain of joints with a tool at its end; ``base_link`` is the frame of all poses.

    The chain's other joints have the positions ``fixed``, by default 0. ``tool`` is the pose of the tool in the last
    link.
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
        self.joints = tuple(joints)  # names of the moving joints
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
        self.sliding = np.flatnonzero(slides).tolist()  # indices of prismatic joints
        self._parts = self._before[:, None] @ constant_parts(self._axes, np.zeros_like(self._axes), slides)
        lower, upper = (np.array([getattr(joint, end) for joint in moving]) for end in ("lower", "upper"))
        self.bounded = np.isfinite(lower)  # (joints,) whether each joint has limits
        self.lower = np.where(self.bounded, lower, -np.pi)  # (joints,) rad or m; -pi without a limit
        self.upper = np.where(self.bounded, upper, np.pi)  # (joints,) rad or m; pi without a limit
        self.shoulder: Array = self._before[0, :3, 3] if moving else np.zeros(3)  # first joint in the base link, m
        links = np.linalg.norm(self._before[1:, :3, 3], axis=1).sum() + np.linalg.norm(before[:3, 3])
        # greatest distance of the tool from the first joint, m
        self.length = float(links + np.maximum(np.abs(self.lower), np.abs(self.upper))[self.sliding].sum())

    def poses(self, postures: Array) -> Array:
        """Return poses (n, 4, 4) of the tool in the base link for postures (n, joints)."""
        poses: Array = self._transforms(postures)[-1] @ self._tool
        return poses

    def frames(self, postures: Array) -> Array:
        """Return frames (joints, n, 4, 4) after the joints in the base link for postures (n, joints)."""
        return self._transforms(postures)[1:]

    def at_zero(self) -> tuple[Array, Array, Array]:
        """Return points (joints, 3) of the axes, the axes (joints, 3), and the tool's pose, with joints at zero."""
        poses, axes = self._frames(np.zeros((1, len(self.joints))))
        return poses[:, 0, :3, 3], axes[0].T, poses[-1, 0] @ self._tool

    def forward(self, postures: Array) -> tuple[Array, Array]:
        """Return poses (n, 4, 4) of the tool in the base link, and Jacobians (n, 6, joints): linear, then angular."""
        poses, axes = self._frames(postures)
        pose = poses[-1] @ self._tool
        lever = pose[:, :3, 3, None] - poses[:, :, :3, 3].transpose(1, 2, 0)
        linear = np.stack(  # a cross product; np.cross is ten times slower for arrays of this size
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
        """Return frames (joints, n, 4, 4) after the joints, and their axes (n, 3, joints)."""
        poses = self.frames(postures)
        return poses, np.einsum("jnab,jb->naj", poses[:, :, :3, :3], self._axes)  # a joint doesn't move its own axis

    def _transforms(self, postures: Array) -> Array:
        """Return poses (joints + 1, n, 4, 4) in the base link: of the base link and of the frame after each joint."""
        poses = np.empty((len(self.joints) + 1, len(postures), 4, 4))
        poses[0] = np.eye(4)
        for number, moved in enumerate(transforms(self._parts, postures.T)):
            np.matmul(poses[number], moved, out=poses[number + 1])
        return poses

    def limited(self, postures: Array) -> Array:
        """Return postures (n, joints) within the limits; joints without limits are within half a turn."""
        wrapped = (postures + np.pi) % (2 * np.pi) - np.pi
        return np.where(self.bounded, np.clip(postures, self.lower, self.upper), wrapped)

    def errors(self, postures: Array, goals: Array, turns: Array | None) -> Array:
        """Return the distances (n, 2) of the tool from targets, in m and rad, for postures (n, joints).

        A goal is (3,) or (n, 3) in the base link, m; a turn is (3, 3) or (n, 3, 3), or None for any orientation.
        """
        pose = self.poses(postures)
        errors = np.zeros((len(postures), 2))
        errors[:, 0] = norms(pose[:, :3, 3] - goals)
        if turns is not None:
            errors[:, 1] = norms(rotation_error(pose[:, :3, :3], turns))
        return errors


def rotation_error(now: Array, goal: Array) -> Array:
    """Return rotation vectors (n, 3) from orientations (n, 3, 3) to a goal (3, 3) or (n, 3, 3)."""
    difference = (goal @ now.transpose(0, 2, 1)).reshape(-1, 9)  # the elements of each matrix, row by row
    vector = 0.5 * (difference[:, [7, 2, 3]] - difference[:, [5, 6, 1]])
    sine = norms(vector)
    cosine = 0.5 * (difference[:, ::4].sum(axis=1) - 1)
    angle = np.arctan2(sine, cosine)
    flipped = (sine < _OPPOSITE) & (cosine < 0)  # half a turn, for which any axis is good
    if flipped.any():
        vector[flipped] = np.array([1e-3, 2e-3, 3e-3])
        sine = norms(vector)
    error: Array = vector * (angle / np.maximum(sine, 1e-12))[:, None]
    return error


def norms(vectors: Array) -> Array:
    """Return the norms (n,) of a few vectors (n, d); this is faster than np.linalg.norm."""
    found: Array = np.sqrt((vectors * vectors).sum(axis=1))
    return found


def constant_parts(axes: Array, points: Array, slides: Flags) -> Array:
    """Return matrices (joints, 4, 4, 4) whose weighted sums are the transforms of joints.

    The weights are 1, the cosine and the sine of the joint position, and the joint position. The axes (joints, 3) are
    unit vectors through points (joints, 3), m; ``slides`` (joints,) is whether each joint is prismatic.
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
    """Return the transforms (joints, n, m, m) of joints at positions (joints, n), rad or m.

    ``parts`` are matrices (joints, 3 or 4, m, m); only prismatic joints need the fourth matrix.
    """
    joints, terms, m, _ = parts.shape
    factors = np.empty((*values.shape, terms))
    factors[..., 0] = 1.0
    np.cos(values, out=factors[..., 1])
    np.sin(values, out=factors[..., 2])
    factors[..., 3:] = values[..., None]
    return (factors @ parts.reshape(joints, terms, m * m)).reshape(*values.shape, m, m)


@dataclass(frozen=True, slots=True)
class Drivers:
    """The joint that moves each link."""

    joints: tuple[str, ...]  # names of the moving joints; a parent comes before its children
    of_links: Mapping[str, int]  # index of the joint that moves each link; -1 for none
    parents: Sequence[int]  # (joints,) index of the joint that moves each joint; -1 for none
    children: Sequence[str]  # (joints,) child link of each joint
    axes: Array  # (joints, 3) unit vectors in the frames of the child links
    slides: NDArray[np.bool_]  # (joints,) whether each joint is prismatic


@lru_cache(maxsize=_CACHED)
def drivers(path: Path, joints: tuple[str, ...]) -> Drivers:
    """Return the joints that move the links of a model with a checked URDF."""
    urdf = stored_tree(path)
    moving: list[UrdfJoint] = []
    of_links: dict[str, int] = {}
    for link in urdf.links:  # a parent comes before its children
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
    """Transforms of a body's links when its joints move from the present pose."""

    def __init__(self, engine: Engine, body: LoadedBody, moved: Drivers) -> None:
        self._joints, self._parents = moved.joints, moved.parents
        self.of_links = moved.of_links  # index of the joint that moves each link; -1 for none
        points, orientations = engine.link_frames(body, moved.children)
        axes = np.einsum("jab,jb->ja", geometry.to_matrices(orientations), moved.axes)
        self._parts = constant_parts(axes, points, moved.slides)
        positions = dict(zip(body.joints, engine.joints(body)[0], strict=True))
        self._now = np.array([positions[name] for name in moved.joints])

    def transforms(self, postures: Sequence[Mapping[str, float]]) -> Array:
        """Return the transforms (n, joints + 1, 4, 4) of each joint's links from their present pose to their new pose.

        The last transform is for links that don't move. Joints without a position (rad or m) in a posture don't move.
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
        return moved.transpose(1, 0, 2, 3)
