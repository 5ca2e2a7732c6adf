"""A URDF: a tree of links, joints with limits and kinematics, and shapes of links.

Lengths are in m, angles in rad, velocities per second. Poses are ``(position, quaternion xyzw)`` of a link's frame in
the frame of the root link. Only direct children of the root element are read, so elements of Gazebo are skipped. Shapes
are read from models that PyCRAM has converted: every shape has a size, every mesh is STL or OBJ.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Final, NamedTuple, TypeAlias

from recorder import geometry
from recorder.errors import suggestion
from recorder.geometry import IDENTITY, Pose, Vector

_CACHED: Final = 32  # largest number of cached documents. Loading and recording a model both parse the document.


@dataclass(frozen=True)
class Urdf:
    """The tree of links of a robot or object."""

    name: str
    root: str
    links: tuple[str, ...]  # names of the links, depth-first from the root, in the document's order
    joints: Mapping[str, UrdfJoint] = field(repr=False)  # the joints by name, in the document's order
    movable: tuple[str, ...] = field(repr=False)  # names of the joints that aren't fixed, in the document's order

    @classmethod
    def parse(cls, text: str | bytes, *, chains: bool = False) -> Urdf:
        """Parse a URDF document. ``chains`` accepts planar and floating joints, which loading replaces by chains.

        UrdfError is raised if the document isn't a single tree of named links with joints of known types.
        """
        return _parse(text, chains)

    def joint(self, name: str) -> UrdfJoint:
        """Return the joint with a name; raise :class:`UrdfError` if there is no such joint."""
        try:
            return self.joints[name]
        except KeyError:
            raise UrdfError(self.name, f"it has no joint {name!r}; {suggestion(name, self.joints)}") from None

    def parent_joint(self, link: str) -> UrdfJoint | None:
        """Return the joint above a link, or None for the root. :class:`UrdfError` is raised if the link is unknown."""
        joint = self._parents.get(link)
        if joint is None and link != self.root:
            raise UrdfError(self.name, f"it has no link {link!r}; {suggestion(link, self.links)}")
        return joint

    def chain(self, base_link: str, tip_link: str) -> tuple[UrdfJoint, ...]:
        """Return all joints from a link to a link below it. Other links raise :class:`UrdfError`."""
        self.parent_joint(base_link)
        joints: list[UrdfJoint] = []
        link = tip_link
        while link != base_link:
            joint = self.parent_joint(link)
            if joint is None:
                raise UrdfError(self.name, f"link {tip_link} isn't below link {base_link}")
            joints.append(joint)
            link = joint.parent
        return tuple(joints[::-1])

    def forward_kinematics(self, positions: Mapping[str, float], link: str) -> Pose:
        """Return the pose of a link in the root link for joint values in rad or m, by name; see :meth:`value`."""
        pose = IDENTITY
        for joint in self.chain(self.root, link):
            pose = geometry.multiply(pose, joint.pose(self.value(joint.name, positions)))
        return pose

    def link_poses(self, positions: Mapping[str, float]) -> dict[str, Pose]:
        """Return the poses of all links in the root link by link name, as :meth:`forward_kinematics` does."""
        poses = {self.root: IDENTITY}
        for link in self.links[1:]:  # parents come before their children
            joint = self._parents[link]
            poses[link] = geometry.multiply(poses[joint.parent], joint.pose(self.value(joint.name, positions)))
        return poses

    def followers(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return the positions (rad or m) of the joints that mimic the given joints, by name, within their limits."""
        return {
            name: self._following(name, mimic, positions[mimic.leader])
            for name, mimic in self.mimics.items()
            if mimic.leader in positions
        }

    def _following(self, name: str, mimic: Mimic, leader: float) -> float:
        joint = self.joints[name]
        return min(max(mimic.multiplier * leader + mimic.offset, joint.lower), joint.upper)

    def value(self, joint: str, positions: Mapping[str, float]) -> float:
        """Return a joint's position (rad or m): the given position, or the position by the joint's rule, or else 0."""
        value = positions.get(joint)
        if value is not None:
            return value
        if self.joints[joint].mimic is None or joint not in self.mimics:
            return 0.0
        mimic = self.mimics[joint]
        return self._following(joint, mimic, positions.get(mimic.leader, 0.0))

    @cached_property
    def mimics(self) -> Mapping[str, Mimic]:
        """The rules of mimicking joints by name; a joint that mimics a mimicking joint has the combined rule.

        In some published models, a joint mimics a joint that doesn't exist. Such a joint moves independently. If a
        joint mimics itself, UrdfError is raised.
        """
        found = {}
        for joint in self.joints.values():
            mimic, seen = joint.mimic, {joint.name}
            while mimic is not None and mimic.leader in self.joints:
                found[joint.name] = mimic
                leader, multiplier, offset = mimic
                if leader in seen:
                    raise UrdfError(self.name, f"joint {joint.name} mimics itself through {', '.join(sorted(seen))}")
                seen.add(leader)
                above = self.joints[leader].mimic
                mimic = above and Mimic(above.leader, multiplier * above.multiplier, multiplier * above.offset + offset)
        return MappingProxyType(found)

    @cached_property
    def _parents(self) -> dict[str, UrdfJoint]:
        return {joint.child: joint for joint in self.joints.values()}


@lru_cache(maxsize=_CACHED)
def _parse(text: str | bytes, chains: bool) -> Urdf:
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
    joints = [read_joint(name, element, chains=chains) for element in document.findall("joint")]
    _unique(name, "joint", (joint.name for joint in joints))
    parents, children = _ends(name, links, joints)
    roots = [link for link in links if link not in parents]
    if not roots:
        raise UrdfError(name, "its joints form a cycle: every link has a parent")
    if len(roots) > 1:
        raise UrdfError(name, f"it has {len(roots)} root links instead of one: {', '.join(roots)}")
    ordered: list[str] = []
    pending = roots
    while pending:
        link = pending.pop()
        ordered.append(link)
        pending.extend(reversed(children.get(link, [])))
    if len(ordered) < len(links):
        cycle = [link for link in links if link not in set(ordered)]
        raise UrdfError(name, f"its joints form a cycle: {', '.join(cycle)} aren't below {ordered[0]}")
    movable = tuple(joint.name for joint in joints if joint.movable)
    return Urdf(name, ordered[0], tuple(ordered), MappingProxyType({joint.name: joint for joint in joints}), movable)


def _unique(robot: str, kind: str, names: Iterable[str]) -> list[str]:
    unique: dict[str, None] = {}
    for name in names:
        if not name:
            raise UrdfError(robot, f"a {kind} has no name")
        if name in unique:
            raise UrdfError(robot, f"it has two {kind}s named {name}")
        unique[name] = None
    return list(unique)


def _ends(robot: str, links: list[str], joints: list[UrdfJoint]) -> tuple[dict[str, UrdfJoint], dict[str, list[str]]]:
    """Return the parent joint of each link, and the child links of each link."""
    names = set(links)
    parents: dict[str, UrdfJoint] = {}
    children: dict[str, list[str]] = {}
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in names:
                raise UrdfError(robot, f"{role} {link!r} of joint {joint.name} isn't a link; {suggestion(link, links)}")
        if joint.child in parents:
            first = parents[joint.child].name
            raise UrdfError(robot, f"link {joint.child} has two parent joints, {first} and {joint.name}")
        parents[joint.child] = joint
        children.setdefault(joint.parent, []).append(joint.child)
    return parents, children


_KINDS: Final = ("fixed", "revolute", "continuous", "prismatic")
_CHAINS: Final = ("planar", "floating")  # types of joints that loading replaces by chains of other joints


class UrdfError(ValueError):
    """A URDF isn't a tree of links, or lacks an element of a given name."""

    def __init__(self, robot: str, reason: str) -> None:
        super().__init__(f"URDF {robot!r}: {reason}" if robot else f"URDF: {reason}")
        self.robot = robot
        self.reason = reason


class Mimic(NamedTuple):
    """The rule of a mimicking joint: its value is ``multiplier * value of the mimicked joint + offset``."""

    leader: str  # name of the mimicked joint
    multiplier: float = 1.0  # factor between joint values: unitless, m/rad or rad/m
    offset: float = 0.0  # constant part of the joint value, rad or m


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """A joint: the connection of a link to its parent link."""

    name: str
    type: str  # type of the joint: "fixed", "revolute", "continuous" or "prismatic"
    parent: str  # name of the parent link
    child: str  # name of the child link
    origin: Pose = IDENTITY  # pose of the joint in the parent link, and of the child link at value 0
    axis: Vector = (1.0, 0.0, 0.0)  # axis: a unit vector in the joint's frame
    lower: float = 0.0  # lower limit in rad or m; -inf if continuous, 0 if fixed
    upper: float = 0.0  # upper limit in rad or m; inf if continuous, 0 if fixed
    effort: float = math.inf  # maximum force or torque in N or Nm; inf if it isn't given
    velocity: float = math.inf  # maximum velocity in rad/s or m/s; inf if it isn't given
    mimic: Mimic | None = None  # the rule if the joint mimics another; None otherwise

    @property
    def movable(self) -> bool:
        """Whether the joint isn't fixed."""
        return self.type != "fixed"

    def pose(self, value: float) -> Pose:
        """Return the pose of the child link in the parent link, for a joint value in rad or m."""
        if self.type == "fixed":
            return self.origin
        if self.type == "prismatic":
            x, y, z = self.axis
            return geometry.transform(self.origin, (x * value, y * value, z * value)), self.origin[1]
        half = value / 2.0
        s = math.sin(half)
        x, y, z = self.axis
        return self.origin[0], geometry.product(self.origin[1], (x * s, y * s, z * s, math.cos(half)))


def read_joint(robot: str, element: ET.Element, *, chains: bool = False) -> UrdfJoint:
    """Parse a joint's element, or raise UrdfError. ``chains`` means that planar and floating joints are accepted."""
    name = element.get("name", "")
    kind = element.get("type", "")
    if kind not in _KINDS and not (chains and kind in _CHAINS):
        known = ", ".join((*_KINDS, *_CHAINS) if chains else _KINDS)
        raise UrdfError(robot, f"joint {name or '(without name)'} is {kind!r}, not one of {known}")
    ends = {}
    for role in ("parent", "child"):
        end = element.find(role)
        if end is None or not end.get("link"):
            raise UrdfError(robot, f"joint {name} has no {role} link")
        ends[role] = end.get("link", "")
    origin = element.find("origin")
    pose = IDENTITY
    if origin is not None:
        position = _three_numbers(robot, name, "origin xyz", origin.get("xyz", "0 0 0"))
        roll, pitch, yaw = _three_numbers(robot, name, "origin rpy", origin.get("rpy", "0 0 0"))
        pose = (position, geometry.from_rpy(roll, pitch, yaw))
    lower, upper, effort, velocity = _limits(robot, name, kind, element.find("limit"))
    mimic = None
    if kind != "fixed" and (mimicking := element.find("mimic")) is not None:
        multiplier = _number(robot, name, "mimic multiplier", mimicking.get("multiplier", "1"))
        offset = _number(robot, name, "mimic offset", mimicking.get("offset", "0"))
        mimic = Mimic(mimicking.get("joint", ""), multiplier, offset)
    return UrdfJoint(
        name=name,
        type=kind,
        parent=ends["parent"],
        child=ends["child"],
        origin=pose,
        axis=_axis(robot, name, element) if kind not in ("fixed", "floating") else (1.0, 0.0, 0.0),
        lower=lower,
        upper=upper,
        effort=effort,
        velocity=velocity,
        mimic=mimic,
    )


def _axis(robot: str, joint: str, element: ET.Element) -> Vector:
    axis = element.find("axis")
    x, y, z = _three_numbers(robot, joint, "axis xyz", axis.get("xyz", "1 0 0") if axis is not None else "1 0 0")
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
    if kind in ("continuous", *_CHAINS):
        return -math.inf, math.inf, effort, velocity
    if limit is None:
        raise UrdfError(robot, f"{kind} joint {joint} has no limits")
    lower, upper = number("lower", 0.0), number("upper", 0.0)
    if lower > upper:
        raise UrdfError(robot, f"joint {joint} has a lower limit {lower:g} above its upper limit {upper:g}")
    return lower, upper, effort, velocity


def _number(robot: str, joint: str, what: str, text: str) -> float:
    try:
        return finite(text)
    except ValueError:
        raise UrdfError(robot, f"{what} of joint {joint} is {text!r}, not a number") from None


def finite(text: str) -> float:
    """Return a text as a finite number, or raise ValueError, also for texts that Python accepts, such as 1_0."""
    value = float(text)
    if not math.isfinite(value) or "_" in text or not text.isascii():
        raise ValueError(text)
    return value


def _three_numbers(robot: str, joint: str, what: str, text: str) -> Vector:
    parts = text.split()
    if len(parts) != 3:
        raise UrdfError(robot, f"{what} of joint {joint} is {text!r}, not three numbers")
    x, y, z = (_number(robot, joint, what, part) for part in parts)
    return x, y, z


Color: TypeAlias = "tuple[float, float, float, float]"  # RGBA 0..1

GREY: Final[Color] = (0.8, 0.8, 0.8, 1.0)
_SIZES: Final = {"box": ("size",), "sphere": ("radius",), "mesh": ("scale",)}  # other kinds have radius and length


@dataclass(frozen=True, slots=True)
class Shape:
    """A shape of a link."""

    kind: str  # kind of the shape: "box", "cylinder", "sphere", "capsule" or "mesh"
    size: tuple[float, ...]  # sizes in m: edges of a box; radius and length; or the scale of a mesh
    mesh: str  # path of the mesh, as in the model; "" for other shapes
    pose: Pose  # pose in the link's frame
    color: Color  # RGBA 0..1 of the model, or grey


def read_shapes(model: str | bytes, role: str) -> dict[str, list[Shape]]:
    """Return the "visual" or "collision" shapes of a URDF by link name. Links without shapes are left out."""
    return shapes_in(ET.fromstring(model), role)  # noqa: S314  PyCRAM wrote the model


def shapes_in(root: ET.Element, role: str) -> dict[str, list[Shape]]:
    """Return the "visual" or "collision" shapes of a parsed URDF by link name."""
    palette = {str(element.get("name")): color for element in root.findall("material") if (color := _rgba(element))}
    by_link = {}
    for link in root.findall("link"):
        shapes = [shape for element in link.findall(role) if (shape := _shape(element, palette))]
        if shapes:
            by_link[link.get("name", "")] = shapes
    return by_link


def _shape(element: ET.Element, palette: Mapping[str, Color]) -> Shape | None:
    shape = element.find("geometry/*")
    if shape is None:
        return None
    material = element.find("material")
    color = None if material is None else _rgba(material) or palette.get(material.get("name", ""))
    origin = element.find("origin")
    xyz, rpy = ("0 0 0", "0 0 0") if origin is None else (origin.get("xyz", "0 0 0"), origin.get("rpy", "0 0 0"))
    x, y, z = _numbers(xyz)
    keys = _SIZES.get(shape.tag, ("radius", "length"))
    size = tuple(number for key in keys for number in _numbers(shape.get(key, "1 1 1")))
    pose = ((x, y, z), geometry.from_rpy(*_numbers(rpy)))
    return Shape(shape.tag, size, shape.get("filename", ""), pose, color or GREY)


def _rgba(material: ET.Element) -> Color | None:
    element = material.find("color")
    if element is None:
        return None
    red, green, blue, alpha = _numbers(element.get("rgba", ""))
    return red, green, blue, alpha


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split())
