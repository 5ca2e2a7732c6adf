"""The tree of a URDF: links, joints with their limits, and where every link is for given joint values.

Pure arithmetic on the description, without any physics engine: inverse kinematics, transforms for viewers and the
replay of recordings all read poses from here. Lengths are metres, angles radians, velocities per second; poses are
``(position, quaternion xyzw)`` of the link's frame in the frame of the root link.

A joint without a given value stands at 0. ``mimic`` is data: every joint keeps its own value, as in PyBullet, and
whoever moves the leader moves the others by :meth:`Urdf.with_mimics`.
"""

from __future__ import annotations

import difflib
import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

from recorder import geometry
from recorder.geometry import IDENTITY, Pose, Vector

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

_KINDS: Final = ("fixed", "revolute", "continuous", "prismatic")


class UrdfError(ValueError):
    """A URDF that is no tree of links, or a name that it doesn't have.

    Attributes:
        robot: name of the robot.
        reason: what is wrong.
    """

    def __init__(self, robot: str, reason: str) -> None:
        super().__init__(f"URDF {robot!r}: {reason}" if robot else f"URDF: {reason}")
        self.robot = robot
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another: ``multiplier * leader + offset``.

    Attributes:
        joint: name of the leader.
        multiplier: factor.
        offset: summand in rad or m.
    """

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint:
    """What holds a link to its parent.

    Attributes:
        name: its name.
        type: "fixed", "revolute", "continuous" or "prismatic".
        parent: name of the parent link.
        child: name of the child link.
        origin: pose of the joint (and of the child at value 0) in the parent link.
        axis: unit vector in the joint's frame.
        lower: lower limit in rad or m; -inf if continuous, 0 if fixed.
        upper: upper limit in rad or m; inf if continuous, 0 if fixed.
        effort: largest force or torque in N or Nm, inf if not given.
        velocity: largest velocity in rad/s or m/s, inf if not given.
        mimic: whom it follows, or None.
    """

    name: str
    type: str
    parent: str
    child: str
    origin: Pose = IDENTITY
    axis: Vector = (1.0, 0.0, 0.0)
    lower: float = 0.0
    upper: float = 0.0
    effort: float = math.inf
    velocity: float = math.inf
    mimic: Mimic | None = None

    @property
    def movable(self) -> bool:
        """Whether it has a value at all."""
        return self.type != "fixed"

    def pose(self, value: float) -> Pose:
        """Pose of the child link in the parent link.

        Args:
            value: joint value in rad or m; without meaning for a fixed joint.
        """
        if self.type == "fixed":
            return self.origin
        if self.type == "prismatic":
            x, y, z = self.axis
            return geometry.transform(self.origin, (x * value, y * value, z * value)), self.origin[1]
        half = value / 2.0
        s = math.sin(half)
        x, y, z = self.axis
        return self.origin[0], geometry.product(self.origin[1], (x * s, y * s, z * s, math.cos(half)))


@dataclass(frozen=True, slots=True)
class _Layers:
    """The tree as arrays, for all links at once.

    With the joint's value q, the 4 x 4 matrix of joint i is ``basis[i, 0] + s * basis[i, 1] + c * basis[i, 2]``, where
    (s, c) is (sin q, cos q) of a turning joint and (q, 0) of a sliding one.

    Attributes:
        order: the joints, parents before children.
        movable: indices into ``order`` of the joints with a value.
        turns: for each of these, whether it turns.
        basis: (number of joints, 3, 4, 4).
        levels: for each depth of the tree: rows of the joints there and rows of their parents; row 0 is the root,
            row i + 1 the child of joint i.
    """

    order: tuple[Joint, ...]
    movable: NDArray[np.intp]
    turns: NDArray[np.bool_]
    basis: NDArray[np.float64]
    levels: tuple[tuple[NDArray[np.intp], NDArray[np.intp]], ...]


def joint_basis(joint: Joint) -> NDArray[np.float64]:
    """A joint's matrix, taken apart into constants.

    Args:
        joint: the joint.

    Returns:
        (3, 4, 4): the matrix from parent to child link is ``b[0] + s * b[1] + c * b[2]`` with (s, c) = (sin q, cos q)
        of a turning joint and (q, 0) of a sliding one.
    """
    origin = geometry.pose_matrix(joint.origin)
    axis = np.array(joint.axis)
    basis = np.zeros((3, 4, 4))
    basis[0] = origin
    if joint.type == "prismatic":
        basis[1, :3, 3] = origin[:3, :3] @ axis
    elif joint.movable:
        # Rodrigues: a a' + sin q [a] + cos q (1 - a a')
        along = np.outer(axis, axis)
        x, y, z = joint.axis
        basis[0, :3, :3] = origin[:3, :3] @ along
        basis[1, :3, :3] = origin[:3, :3] @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        basis[2, :3, :3] = origin[:3, :3] @ (np.eye(3) - along)
    return basis


@dataclass(frozen=True)
class Urdf:
    """A robot's or thing's tree of links.

    Attributes:
        name: name of the robot.
        root: name of the root link.
        links: names of the links: the root, then depth first in the document's order.
        joints: the joints by name, in the document's order.
        movable: names of the joints with a value, in the document's order.
    """

    name: str
    root: str
    links: tuple[str, ...]
    joints: Mapping[str, Joint] = field(repr=False)
    movable: tuple[str, ...] = field(repr=False)

    @classmethod
    def parse(cls, text: str | bytes) -> Urdf:
        """Reads a URDF document.

        Args:
            text: the XML.

        Returns:
            Its tree.

        Raises:
            UrdfError: it isn't XML, or not one tree of named links with joints of known types.
        """
        try:
            document = ET.fromstring(text)  # noqa: S314
        except ET.ParseError as error:
            raise UrdfError("", f"not well-formed XML: {error}") from error
        name = document.get("name", "")
        if document.tag != "robot":
            raise UrdfError(name, f"its root element is <{document.tag}>, not <robot>")
        links = _unique(name, "link", (element.get("name", "") for element in document.findall("link")))
        if not links:
            raise UrdfError(name, "it has no links")
        joints = [_joint(name, element) for element in document.findall("joint")]
        _unique(name, "joint", (joint.name for joint in joints))
        return cls._of(name, links, joints)

    @classmethod
    def _of(cls, name: str, links: list[str], joints: list[Joint]) -> Urdf:
        parents, children = _ends(name, links, joints)
        roots = [link for link in links if link not in parents]
        if not roots:
            raise UrdfError(name, "its joints form a cycle: every link has a parent")
        if len(roots) > 1:
            raise UrdfError(name, f"it has {len(roots)} root links where one is needed: {', '.join(roots)}")
        ordered: list[str] = []
        pending = roots
        while pending:
            link = pending.pop()
            ordered.append(link)
            pending.extend(reversed(children.get(link, [])))
        if len(ordered) < len(links):
            lost = [link for link in links if link not in set(ordered)]
            raise UrdfError(name, f"its joints form a cycle: {', '.join(lost)} don't hang on {ordered[0]}")
        by_name = {joint.name: joint for joint in joints}
        for joint in joints:
            if joint.mimic is not None and joint.mimic.joint not in by_name:
                hint = _near(joint.mimic.joint, by_name)
                raise UrdfError(name, f"joint {joint.name} mimics {joint.mimic.joint!r}, which is no joint; {hint}")
        movable = tuple(joint.name for joint in joints if joint.movable)
        return cls(name, ordered[0], tuple(ordered), MappingProxyType(by_name), movable)

    def joint(self, name: str) -> Joint:
        """A joint by its name.

        Args:
            name: its name.

        Raises:
            UrdfError: there is no such joint.
        """
        try:
            return self.joints[name]
        except KeyError:
            raise UrdfError(self.name, f"it has no joint {name!r}; {_near(name, self.joints)}") from None

    def parent_joint(self, link: str) -> Joint | None:
        """The joint that holds a link.

        Args:
            link: name of the link.

        Returns:
            The joint, or None for the root.

        Raises:
            UrdfError: there is no such link.
        """
        joint = self._parents.get(link)
        if joint is None and link != self.root:
            raise UrdfError(self.name, f"it has no link {link!r}; {_near(link, self.links)}")
        return joint

    def chain(self, base_link: str, tip_link: str) -> tuple[Joint, ...]:
        """The joints that lead from one link out to another, fixed ones too.

        Args:
            base_link: where it starts: the tip itself or one of its ancestors.
            tip_link: where it ends.

        Returns:
            The joints from base to tip.

        Raises:
            UrdfError: a link doesn't exist, or the tip doesn't hang on the base.
        """
        self.parent_joint(base_link)
        found: list[Joint] = []
        link = tip_link
        while link != base_link:
            joint = self.parent_joint(link)
            if joint is None:
                raise UrdfError(self.name, f"link {tip_link} doesn't hang on {base_link}")
            found.append(joint)
            link = joint.parent
        return tuple(reversed(found))

    def forward_kinematics(self, positions: Mapping[str, float], link: str) -> Pose:
        """Where a link is.

        Args:
            positions: joint values in rad or m by name; joints that aren't named stand at 0.
            link: name of the link.

        Returns:
            Position in m and orientation xyzw in the root link.

        Raises:
            UrdfError: there is no such link.
        """
        return self.relative_pose(positions, self.root, link)

    def relative_pose(self, positions: Mapping[str, float], base_link: str, tip_link: str) -> Pose:
        """Where a link is as seen from one that carries it.

        Args:
            positions: joint values in rad or m by name; joints that aren't named stand at 0.
            base_link: the link to measure from: the tip itself or one of its ancestors.
            tip_link: the link to find.

        Returns:
            Position in m and orientation xyzw in the base link.

        Raises:
            UrdfError: a link doesn't exist, or the tip doesn't hang on the base.
        """
        pose = IDENTITY
        for joint in self.chain(base_link, tip_link):
            pose = geometry.multiply(pose, joint.pose(positions.get(joint.name, 0.0)))
        return pose

    def link_poses(self, positions: Mapping[str, float]) -> dict[str, Pose]:
        """Where all links are, computed at once.

        Args:
            positions: joint values in rad or m by name; joints that aren't named stand at 0.

        Returns:
            Position in m and orientation xyzw in the root link by link name, parents before children.
        """
        matrices = self.link_matrices(positions)
        at = matrices[:, :3, 3].tolist()
        turns = geometry.from_matrices(matrices[:, :3, :3]).tolist()
        names = (self.root, *(joint.child for joint in self._layers.order))
        return {name: (tuple(p), tuple(q)) for name, p, q in zip(names, at, turns, strict=True)}

    def link_matrices(self, positions: Mapping[str, float]) -> NDArray[np.float64]:
        """Where all links are, as matrices.

        Args:
            positions: joint values in rad or m by name; joints that aren't named stand at 0.

        Returns:
            (number of links, 4, 4): poses in the root link, in the order of :attr:`links`.
        """
        layers = self._layers
        order = layers.order
        values = np.array([positions.get(order[i].name, 0.0) for i in layers.movable.tolist()], dtype=np.float64)
        local = layers.basis[:, 0].copy()
        if len(values):
            moving = layers.basis[layers.movable]
            first = np.where(layers.turns, np.sin(values), values)
            local[layers.movable] += first[:, None, None] * moving[:, 1] + np.cos(values)[:, None, None] * moving[:, 2]
        result = np.empty((len(order) + 1, 4, 4))
        result[0] = np.eye(4)
        for rows, parents in layers.levels:
            result[rows] = result[parents] @ local[rows - 1]
        return result

    def joint_transform(self, joint: str, value: float) -> Pose:
        """Pose of a joint's child link in its parent link.

        Args:
            joint: name of the joint.
            value: joint value in rad or m; without meaning for a fixed joint.

        Returns:
            Position in m and orientation xyzw.

        Raises:
            UrdfError: there is no such joint.
        """
        return self.joint(joint).pose(value)

    def with_mimics(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Joint values with those of the joints that follow them.

        Args:
            positions: joint values in rad or m by name.

        Returns:
            These, and ``multiplier * leader + offset`` for each joint that mimics one of them and isn't named itself.
        """
        followers = {
            joint.name: joint.mimic.multiplier * positions[joint.mimic.joint] + joint.mimic.offset
            for joint in self.joints.values()
            if joint.mimic is not None and joint.mimic.joint in positions and joint.name not in positions
        }
        return {**positions, **followers}

    @cached_property
    def _parents(self) -> dict[str, Joint]:
        return {joint.child: joint for joint in self.joints.values()}

    @cached_property
    def _layers(self) -> _Layers:
        order = tuple(self._parents[link] for link in self.links[1:])
        row = {link: i for i, link in enumerate(self.links)}
        depth = {self.root: 0}
        levels: dict[int, list[int]] = {}
        for joint in order:
            depth[joint.child] = depth[joint.parent] + 1
            levels.setdefault(depth[joint.child], []).append(row[joint.child])
        movable = [i for i, joint in enumerate(order) if joint.movable]
        return _Layers(
            order=order,
            movable=np.array(movable, dtype=np.intp),
            turns=np.array([order[i].type != "prismatic" for i in movable], dtype=np.bool_),
            basis=np.array([joint_basis(joint) for joint in order]).reshape(-1, 3, 4, 4),
            levels=tuple(
                (
                    np.array(rows, dtype=np.intp),
                    np.array([row[order[i - 1].parent] for i in rows], dtype=np.intp),
                )
                for _, rows in sorted(levels.items())
            ),
        )


def _near(name: str, known: Iterable[str]) -> str:
    names = list(known)
    nearest = difflib.get_close_matches(name, names, n=3, cutoff=0.4)
    return f"did you mean {', '.join(nearest)}?" if nearest else f"it has {len(names)} of them"


def _unique(robot: str, kind: str, names: Iterable[str]) -> list[str]:
    found: dict[str, None] = {}
    for name in names:
        if not name:
            raise UrdfError(robot, f"a {kind} has no name")
        if name in found:
            raise UrdfError(robot, f"it has two {kind}s of the name {name}")
        found[name] = None
    return list(found)


def _ends(robot: str, links: list[str], joints: list[Joint]) -> tuple[dict[str, Joint], dict[str, list[str]]]:
    """The joint above each link, and the links below it."""
    known = set(links)
    parents: dict[str, Joint] = {}
    children: dict[str, list[str]] = {}
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in known:
                raise UrdfError(robot, f"{role} {link!r} of joint {joint.name} is no link; {_near(link, links)}")
        if joint.child in parents:
            other = parents[joint.child].name
            raise UrdfError(robot, f"link {joint.child} has two parent joints, {other} and {joint.name}")
        parents[joint.child] = joint
        children.setdefault(joint.parent, []).append(joint.child)
    return parents, children


def _joint(robot: str, element: ET.Element) -> Joint:
    name = element.get("name", "")
    kind = element.get("type", "")
    if kind not in _KINDS:
        raise UrdfError(robot, f"joint {name or '(without name)'} is {kind!r}, not one of {', '.join(_KINDS)}")
    ends = {}
    for role in ("parent", "child"):
        end = element.find(role)
        if end is None or not end.get("link"):
            raise UrdfError(robot, f"joint {name} has no {role} link")
        ends[role] = end.get("link", "")
    origin = element.find("origin")
    pose = IDENTITY
    if origin is not None:
        at = _numbers(robot, name, "origin xyz", origin.get("xyz", "0 0 0"))
        roll, pitch, yaw = _numbers(robot, name, "origin rpy", origin.get("rpy", "0 0 0"))
        pose = (at, geometry.from_rpy(roll, pitch, yaw))
    lower, upper, effort, velocity = _limits(robot, name, kind, element.find("limit"))
    return Joint(
        name=name,
        type=kind,
        parent=ends["parent"],
        child=ends["child"],
        origin=pose,
        axis=_axis(robot, name, element) if kind != "fixed" else (1.0, 0.0, 0.0),
        lower=lower,
        upper=upper,
        effort=effort,
        velocity=velocity,
        mimic=_mimic(robot, name, element),
    )


def _axis(robot: str, joint: str, element: ET.Element) -> Vector:
    axis = element.find("axis")
    x, y, z = _numbers(robot, joint, "axis xyz", axis.get("xyz", "1 0 0") if axis is not None else "1 0 0")
    length = math.hypot(x, y, z)
    if length < 1e-9:
        raise UrdfError(robot, f"axis of joint {joint} is zero")
    return x / length, y / length, z / length


def _limits(robot: str, joint: str, kind: str, limit: ET.Element | None) -> tuple[float, float, float, float]:
    def number(attribute: str, default: float) -> float:
        text = limit.get(attribute) if limit is not None else None
        return default if text is None else _number(robot, joint, f"limit {attribute}", text)

    effort, velocity = number("effort", math.inf), number("velocity", math.inf)
    if kind == "fixed":
        return 0.0, 0.0, effort, velocity
    if kind == "continuous":
        return -math.inf, math.inf, effort, velocity
    if limit is None:
        raise UrdfError(robot, f"{kind} joint {joint} has no limits")
    lower, upper = number("lower", 0.0), number("upper", 0.0)
    if lower > upper:
        raise UrdfError(robot, f"joint {joint} has a lower limit {lower:g} above its upper limit {upper:g}")
    return lower, upper, effort, velocity


def _mimic(robot: str, joint: str, element: ET.Element) -> Mimic | None:
    mimic = element.find("mimic")
    if mimic is None:
        return None
    return Mimic(
        mimic.get("joint", ""),
        _number(robot, joint, "mimic multiplier", mimic.get("multiplier", "1")),
        _number(robot, joint, "mimic offset", mimic.get("offset", "0")),
    )


def _number(robot: str, joint: str, what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UrdfError(robot, f"{what} of joint {joint} is {text!r}, not a number")
    return value


def _numbers(robot: str, joint: str, what: str, text: str) -> Vector:
    parts = text.split()
    if len(parts) != 3:
        raise UrdfError(robot, f"{what} of joint {joint} is {text!r}, not three numbers")
    x, y, z = (_number(robot, joint, what, part) for part in parts)
    return x, y, z
