"""Arms as data: a chain of joints from a base link to a tool frame, with named postures and what is at its end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, MissingPart, UnknownName
from pycram.models.robots import tables
from pycram.models.robots.gripper import Gripper, read_gripper
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recorder.geometry import Pose, PoseLike
    from recorder.urdf import Urdf


@dataclass(frozen=True, slots=True)
class Arm:
    """An arm.

    Attributes:
        name: any name: "left", "right", "panda", ...
        joints: its joints from the shoulder on.
        base_link: the link that its first joint hangs on.
        tool_frame: the link with the tool frame: x points out of the gripper, the fingers close along y.
        tool_offset: pose of the tool frame in that link, where that isn't the tool frame itself.
        hand: its gripper, if it has one.
        poses: named postures, values in the order of the joints.
    """

    name: str
    joints: tuple[str, ...]
    base_link: str
    tool_frame: str
    tool_offset: Pose
    hand: Gripper | None
    poses: Mapping[str, tuple[float, ...]]

    @property
    def gripper(self) -> Gripper:
        """Its gripper.

        Raises:
            MissingPart: It has none.
        """
        if self.hand is None:
            raise MissingPart(f"{self.name} arm", "gripper")
        return self.hand

    def tool_pose(self, link_pose: PoseLike) -> Pose:
        """Return the tool frame's pose for the pose of its link, both in the same frame."""
        return geometry.multiply(link_pose, self.tool_offset)

    def posture(self, name: str) -> dict[str, float]:
        """Return the joint values of a named posture.

        Raises:
            UnknownName: The arm has none of that name.
        """
        if name not in self.poses:
            raise UnknownName("named pose", name, f"the {self.name} arm", self.poses)
        return dict(zip(self.joints, self.poses[name], strict=True))

    def links(self) -> list[str]:
        """Return all links that its description names."""
        hand = [self.hand.palm, *self.hand.fingers] if self.hand else []
        return [self.base_link, self.tool_frame, *hand]

    def values(self) -> dict[str, list[float]]:
        """Return all joints that its description names, with all values that it has for them."""
        values = {joint: [posture[i] for posture in self.poses.values()] for i, joint in enumerate(self.joints)}
        if self.hand:
            values |= {joint: [self.hand.at(0.0)[joint], self.hand.at(1.0)[joint]] for joint in self.hand.joints}
        return values

    def bias(self, urdf: Urdf) -> float:
        """Return how unevenly the sides of its gripper close; see :meth:`Gripper.bias`."""
        return self.gripper.bias(urdf, self.tool_frame, self.tool_offset)

    def problems(self, urdf: Urdf) -> Iterator[str]:
        """Yield what doesn't fit a URDF that has its links and joints.

        Raises:
            UrdfError: Its tool frame doesn't hang on its base link.
        """
        chain = tuple(joint.name for joint in urdf.chain(self.base_link, self.tool_frame) if joint.movable)
        if chain != self.joints:
            yield f"the {self.name} arm's joints from base_link to tool_frame are {', '.join(chain) or 'none'}"
        elif self.hand:
            for problem in self.hand.wrong_ways(urdf, self.tool_frame, self.tool_offset):
                yield f"the {self.name} gripper: {problem}; tool_offset can turn the tool frame"


def read_arm(name: str, table: tables.Table) -> Arm:
    """Return the arm of a TOML table, checked.

    Raises:
        KeyError: An entry is missing.
        BadArgument: An entry is unknown or impossible.
    """
    tables.only(table, "base_link", "tool_frame", "tool_offset", "joints", "poses", "gripper")
    joints = tables.texts("joints", table["joints"])
    if not joints:
        raise BadArgument("joints", [], "at least one")
    poses: dict[str, tuple[float, ...]] = {}
    for pose, values in tables.table(table, "poses").items() if "poses" in table else ():
        if not isinstance(values, list) or len(values) != len(joints):
            raise BadArgument(f"arms.{name}.poses.{pose}", values, f"{len(joints)} numbers")
        poses[pose] = tuple(checks.number(pose, value) for value in values)
    base_link, tool_frame = (checks.text(key, table[key]) for key in ("base_link", "tool_frame"))
    offset = tables.pose(table, "tool_offset")
    hand = read_gripper(tables.table(table, "gripper")) if "gripper" in table else None
    return Arm(name, joints, base_link, tool_frame, offset, hand, poses)
