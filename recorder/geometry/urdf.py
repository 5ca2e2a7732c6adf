"""The tree of a URDF: links, joints with their limits, and forward kinematics.

Pure arithmetic without any physics engine, for inverse kinematics, viewers' transforms and recordings. Lengths are
metres, angles radians, velocities per second; poses are ``(position, quaternion xyzw)`` of the link's frame in the
frame of the root link.

A joint without a given value is at 0, or where the joint that it mimics has it. Elements of others' namespaces and of
Gazebo, and all that is in them, are not part of the robot: only a document's own children are read.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from recorder import geometry
from recorder.geometry import IDENTITY, Pose
from recorder.geometry.joints import Joint, Mimic, UrdfError, read_joint
from recorder.suggestions import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_CACHED: Final = 32  # documents: a model's is read when it is loaded, and again when it is recorded


@dataclass(frozen=True)
class Urdf:
    """The tree of links of a robot or object.

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
    def parse(cls, text: str | bytes, *, chains: bool = False) -> Urdf:
        """Reads a URDF document.

        Args:
            text: the document.
            chains: whether planar and floating joints may be in it, which have no kinematics of their own: in models
                that are loaded they are chains of other joints.

        Raises:
            UrdfError: it isn't XML, or not one tree of named links with joints of known types.
        """
        return _parse(text, chains)

    def joint(self, name: str) -> Joint:
        """A joint by its name.

        Raises:
            UrdfError: there is no such joint.
        """
        try:
            return self.joints[name]
        except KeyError:
            raise UrdfError(self.name, f"it has no joint {name!r}; {suggestion(name, self.joints)}") from None

    def parent_joint(self, link: str) -> Joint | None:
        """The joint whose child is a link; None for the root.

        Raises:
            UrdfError: there is no such link.
        """
        joint = self._parents.get(link)
        if joint is None and link != self.root:
            raise UrdfError(self.name, f"it has no link {link!r}; {suggestion(link, self.links)}")
        return joint

    def chain(self, base_link: str, tip_link: str) -> tuple[Joint, ...]:
        """The joints from a link to one of its descendants, fixed ones too.

        Raises:
            UrdfError: a link doesn't exist, or the tip is no descendant of the base.
        """
        self.parent_joint(base_link)
        self.parent_joint(tip_link)
        above, below = self._above[base_link], self._above[tip_link]
        if below[: len(above)] != above:
            raise UrdfError(self.name, f"link {tip_link} doesn't hang on {base_link}")
        return below[len(above) :]

    def forward_kinematics(self, positions: Mapping[str, float], link: str) -> Pose:
        """Pose of a link in the root link, from joint values in rad or m by name; by default 0.

        Raises:
            UrdfError: there is no such link.
        """
        pose = IDENTITY
        for joint in self.chain(self.root, link):
            fixed = joint.type == "fixed"  # most are
            at = joint.origin if fixed else joint.pose(self.value(joint.name, positions))
            pose = geometry.multiply(pose, at)
        return pose

    def link_poses(self, positions: Mapping[str, float]) -> dict[str, Pose]:
        """Return where all links are: poses in the root link by the links' names, as for :meth:`forward_kinematics`."""
        poses = {self.root: IDENTITY}
        for link in self.links[1:]:  # parents come before their children
            joint = self._parents[link]
            poses[link] = geometry.multiply(poses[joint.parent], joint.pose(self.value(joint.name, positions)))
        return poses

    def followers(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return where the joints are that mimic one of those given, by name, in rad or m, within their limits.

        Raises:
            UrdfError: a joint mimics itself.
        """
        return {
            name: self._following(name, mimic, positions[mimic.leader])
            for name, mimic in self.mimics.items()
            if mimic.leader in positions
        }

    def _following(self, name: str, mimic: Mimic, leader: float) -> float:
        """Where a joint is whose leader is somewhere; it stops at its own limits."""
        joint = self.joints[name]
        return min(max(mimic.multiplier * leader + mimic.offset, joint.lower), joint.upper)

    def value(self, joint: str, positions: Mapping[str, float]) -> float:
        """Return where a joint is, rad or m, from joint values by name: its own, its leader's, or 0."""
        value = positions.get(joint)
        if value is not None:
            return value
        if self.joints[joint].mimic is None or joint not in self.mimics:
            return 0.0
        mimic = self.mimics[joint]
        return self._following(joint, mimic, positions.get(mimic.leader, 0.0))

    @cached_property
    def mimics(self) -> Mapping[str, Mimic]:
        """What each joint follows that mimics another, by its name; leaders follow none themselves.

        A joint moves on its own if the one that it mimics doesn't exist, as in some published models.

        Raises:
            UrdfError: a joint mimics itself.
        """
        found = {}
        for joint in self.joints.values():
            mimic, seen = joint.mimic, {joint.name}
            while mimic is not None and mimic.leader in self.joints:
                found[joint.name] = mimic
                leader, multiplier, offset = mimic
                if leader in seen:
                    raise UrdfError(self.name, f"joint {joint.name} mimics itself, by way of {', '.join(sorted(seen))}")
                seen.add(leader)
                above = self.joints[leader].mimic
                mimic = above and Mimic(above.leader, multiplier * above.multiplier, multiplier * above.offset + offset)
        return MappingProxyType(found)

    @cached_property
    def _above(self) -> dict[str, tuple[Joint, ...]]:
        """The joints from the root to each link."""
        above: dict[str, tuple[Joint, ...]] = {self.root: ()}
        for link in self.links[1:]:  # parents come before their children
            joint = self._parents[link]
            above[link] = (*above[joint.parent], joint)
        return above

    @cached_property
    def _parents(self) -> dict[str, Joint]:
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
        raise UrdfError(name, f"it has {len(roots)} root links where one is needed: {', '.join(roots)}")
    ordered: list[str] = []
    pending = roots
    while pending:
        link = pending.pop()
        ordered.append(link)
        pending.extend(reversed(children.get(link, [])))
    if len(ordered) < len(links):
        cycle = [link for link in links if link not in set(ordered)]
        raise UrdfError(name, f"its joints form a cycle: {', '.join(cycle)} don't hang on {ordered[0]}")
    by_name = {joint.name: joint for joint in joints}
    movable = tuple(joint.name for joint in joints if joint.movable)
    return Urdf(name, ordered[0], tuple(ordered), MappingProxyType(by_name), movable)


def _unique(robot: str, kind: str, names: Iterable[str]) -> list[str]:
    unique: dict[str, None] = {}
    for name in names:
        if not name:
            raise UrdfError(robot, f"a {kind} has no name")
        if name in unique:
            raise UrdfError(robot, f"it has two {kind}s of the name {name}")
        unique[name] = None
    return list(unique)


def _ends(robot: str, links: list[str], joints: list[Joint]) -> tuple[dict[str, Joint], dict[str, list[str]]]:
    """The joint above each link, and the links below it."""
    names = set(links)
    parents: dict[str, Joint] = {}
    children: dict[str, list[str]] = {}
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in names:
                raise UrdfError(robot, f"{role} {link!r} of joint {joint.name} is no link; {suggestion(link, links)}")
        if joint.child in parents:
            first = parents[joint.child].name
            raise UrdfError(robot, f"link {joint.child} has two parent joints, {first} and {joint.name}")
        parents[joint.child] = joint
        children.setdefault(joint.parent, []).append(joint.child)
    return parents, children
