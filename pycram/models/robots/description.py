"""What process modules and queries have to know of a robot, checked against its URDF.

A process module never holds the name or number of a joint: a second robot is a second TOML file. What a robot doesn't
have, its description leaves out: arms, grippers, a head, a camera, a torso (docs/robots.md).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.foundation import checks
from pycram.foundation.failures import AssetError, BadArgument, MissingPart, UnknownName
from pycram.models.files import parse_toml, read_text
from pycram.models.robots import tables
from pycram.models.robots.gripper import Gripper, read_gripper
from pycram.models.warming import notable
from recorder import geometry
from recorder.urdf import UrdfError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recorder.geometry import Pose, PoseLike
    from recorder.urdf import Urdf

__all__ = [
    "Arm",
    "CameraDescription",
    "Gripper",
    "Head",
    "MotionLimits",
    "RobotDescription",
    "Torso",
    "find_description",
]
_MIN_RATE, _MAX_RATE = 1e-3, 1e3
_MAX_SIGHT: Final = 1e4  # m
_MAX_FOV: Final = 3.1  # rad
_MAX_PIXELS: Final = 1e5


@dataclass(frozen=True, slots=True)
class Torso:
    """A torso that lifts."""

    joint: str  # its joint
    default: float  # value for work at tables, m


@dataclass(frozen=True, slots=True)
class RobotDescription:
    """A robot."""

    robot: str  # name in its URDF
    base_link: str  # the link that poses of the robot are poses of
    arms: Mapping[str, Arm]  # by name
    head: Head | None  # its head, if it has one that turns
    camera: CameraDescription | None  # its camera, if it has one
    torso: Torso | None  # its torso, if it lifts
    drives: bool  # whether its base does; else it stays where it was loaded
    limits: MotionLimits  # how fast it may move
    may_touch: frozenset[frozenset[str]]
    """Pairs of its own links that may overlap, as their shapes do where the robot itself doesn't."""
    text: str  # the TOML that it was read from
    source: str  # the TOML's file, for errors

    @classmethod
    def load(cls, path: str | Path) -> RobotDescription:
        """Read a description from a TOML file.

        Raises:
            AssetError: It can't be read, or an entry is missing, unknown or impossible.
        """
        return cls.parse(read_text(Path(path)), str(path))

    @classmethod
    def parse(cls, text: str, source: str = "robot description") -> RobotDescription:
        """Read a description from TOML; errors name its source.

        Raises:
            AssetError: It isn't TOML, or an entry is missing, unknown or impossible.
        """
        table = parse_toml(text, source)
        try:
            tables.only(table, "robot", "base_link", "drives", "may_touch", "arms", "head", "camera", "torso", "limits")
            arms = tables.table(table, "arms") if "arms" in table else {}
            return cls(
                robot=checks.text("robot", table["robot"]),
                base_link=checks.text("base_link", table["base_link"]),
                arms={checks.text("an arm's name", name): read_arm(name, tables.table(arms, name)) for name in arms},
                head=read_head(tables.table(table, "head")) if "head" in table else None,
                camera=read_camera(tables.table(table, "camera")) if "camera" in table else None,
                torso=tables.record(Torso, tables.table(table, "torso")) if "torso" in table else None,
                drives=checks.switch("drives", table.get("drives", True)),
                limits=read_limits(tables.table(table, "limits")) if "limits" in table else MotionLimits(),
                may_touch=_pairs(table.get("may_touch", [])),
                text=text,
                source=source,
            )
        except KeyError as error:
            raise AssetError(source, f"has no entry {error.args[0]}") from error
        except (BadArgument, TypeError) as error:
            raise AssetError(source, str(error)) from error

    def arm(self, name: str) -> Arm:
        """Return an arm by name.

        Raises:
            UnknownName: It has no such arm.
        """
        if name not in self.arms:
            raise UnknownName("arm", name, self.robot, self.arms)
        return self.arms[name]

    def arm_of(self, tool_frame: str) -> Arm | None:
        """Return the arm with a tool frame's link; None if there is none."""
        return next((arm for arm in self.arms.values() if arm.tool_frame == tool_frame), None)

    def check(self, urdf: Urdf) -> None:
        """Check that all names and values fit the robot's URDF.

        Raises:
            AssetError: A joint or link doesn't exist, a chain isn't one, a value is outside limits, or fingers don't
                close around the tool frame.
        """
        try:
            for link in self._links():
                urdf.parent_joint(link)
            for name, values in self._values().items():
                joint = urdf.joint(name)
                if not joint.movable:
                    raise AssetError(self.source, f"moves {name}, which is fixed")
                for value in values:
                    if not joint.lower <= value <= joint.upper:
                        limits = f"{joint.lower:g} to {joint.upper:g}"
                        raise AssetError(self.source, f"puts {name} to {value:g}, outside of its limits {limits}")
            for arm in self.arms.values():
                for problem in arm.problems(urdf):
                    raise AssetError(self.source, problem)
        except UrdfError as error:
            raise AssetError(self.source, str(error)) from error

    def misfit(self, urdf: Urdf) -> str:
        """Return why it doesn't fit a URDF; "" if it does."""
        try:
            self.check(urdf)
        except AssetError as error:
            return error.cause
        return ""

    def _links(self) -> list[str]:
        """Return all links that it names."""
        links = [self.base_link] + ([self.camera.frame] if self.camera else [])
        links += [link for pair in self.may_touch for link in sorted(pair)]
        return links + [link for arm in self.arms.values() for link in arm.links()]

    def _values(self) -> dict[str, list[float]]:
        """Return all joints that it names, with all values that it has for them."""
        values: dict[str, list[float]] = {joint: [] for joint in (self.head.joints if self.head else ())}
        if self.torso:
            values[self.torso.joint] = [self.torso.default]
        for arm in self.arms.values():
            for joint, more in arm.values().items():  # one may turn an arm and the head
                values.setdefault(joint, []).extend(more)
        return values


def find_description(urdf: Urdf) -> RobotDescription | None:
    """Return PyCRAM's own description of a robot, by the name in its URDF; None if none is of that name, or fits it."""
    return next((own for own in _own() if own.robot == urdf.name and not own.misfit(urdf)), None)


def why_none(urdf: Urdf) -> str:
    """Return why PyCRAM's own description of a robot isn't for this one; "" if it has none of that name."""
    return next((own.misfit(urdf) for own in _own() if own.robot == urdf.name), "")


@cache
@notable
def _own() -> tuple[RobotDescription, ...]:
    return tuple(RobotDescription.load(file) for file in sorted(Path(__file__).parent.glob("*.toml")))


def _pairs(value: object) -> frozenset[frozenset[str]]:
    """Return pairs of two links each."""
    if not isinstance(value, list):
        raise BadArgument("may_touch", value, "a list of pairs of links")
    pairs = frozenset(frozenset(tables.texts("may_touch", pair)) for pair in value)
    if any(len(pair) != 2 for pair in pairs):
        raise BadArgument("may_touch", value, "pairs of two different links each")
    return pairs


@dataclass(frozen=True, slots=True)
class Arm:
    """An arm."""

    name: str  # any name: "left", "right", "panda", ...
    joints: tuple[str, ...]  # its joints from the shoulder on
    base_link: str  # the link that its first joint hangs on
    tool_frame: str  # the link with the tool frame: x points out of the gripper, the fingers close along y
    tool_offset: Pose  # pose of the tool frame in that link, where that isn't the tool frame itself
    hand: Gripper | None  # its gripper, if it has one
    poses: Mapping[str, tuple[float, ...]]  # named postures, values in the order of the joints

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


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Largest velocities and accelerations."""

    turning_velocity: float = 1.0  # of joints that turn and have no velocity limit in the URDF, rad/s
    turning_acceleration: float = 4.0  # of joints that turn, rad/s^2
    sliding_velocity: float = 0.2  # of joints that slide and have no velocity limit in the URDF, m/s
    sliding_acceleration: float = 0.5  # of joints that slide, m/s^2
    base_velocity: float = 0.5  # of the base, m/s
    base_acceleration: float = 0.5  # of the base, m/s^2
    base_turning_velocity: float = 1.0  # of the base about its upright axis, rad/s
    base_turning_acceleration: float = 1.0  # of the base about its upright axis, rad/s^2


def read_limits(table: tables.Table) -> MotionLimits:
    """Return the limits of a TOML table, checked; what it leaves out is as by default.

    Raises:
        BadArgument: An entry is unknown or impossible.
    """
    tables.only(table, *(field.name for field in fields(MotionLimits)))
    return MotionLimits(**{name: checks.in_range(name, value, _MIN_RATE, _MAX_RATE) for name, value in table.items()})


@dataclass(frozen=True, slots=True)
class Head:
    """A head that turns: names of its joints, "" for one that it doesn't have."""

    pan: str = ""  # turns the camera to the left and right
    tilt: str = ""  # turns the camera up and down

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that it has."""
        return tuple(joint for joint in (self.pan, self.tilt) if joint)


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """A camera."""

    frame: str  # the link with its optical frame: z forward, x right, y down
    offset: Pose  # pose of the optical frame in that link, where that isn't the optical frame itself
    horizontal_fov: float  # field of view in rad
    vertical_fov: float  # field of view in rad
    width: int  # pixels
    height: int  # pixels
    near: float  # m from which on it sees
    far: float  # m up to which it sees

    def pose(self, link_pose: PoseLike) -> Pose:
        """Return the optical frame's pose for the pose of its link, both in the same frame."""
        return geometry.multiply(link_pose, self.offset)


def read_head(table: tables.Table) -> Head:
    """Return the head of a TOML table, checked.

    Raises:
        BadArgument: An entry is unknown or impossible, or there is none.
    """
    tables.only(table, "pan", "tilt")
    if not table:
        raise BadArgument("head", table, "the name of a pan joint, of a tilt joint, or of both")
    return Head(**{key: checks.text(key, value) for key, value in table.items()})


def read_camera(table: tables.Table) -> CameraDescription:
    """Return the camera of a TOML table, checked.

    Raises:
        KeyError: An entry is missing.
        BadArgument: An entry is unknown or impossible.
    """
    tables.only(table, "frame", "frame_offset", "horizontal_fov", "vertical_fov", "width", "height", "near", "far")
    wide, high = (checks.in_range(key, table[key], 1e-3, _MAX_FOV) for key in ("horizontal_fov", "vertical_fov"))
    width, height = (int(checks.in_range(key, table[key], 1, _MAX_PIXELS)) for key in ("width", "height"))
    near = checks.in_range("near", table["near"], 1e-4, _MAX_SIGHT)
    return CameraDescription(
        frame=checks.text("frame", table["frame"]),
        offset=tables.pose(table, "frame_offset"),
        horizontal_fov=wide,
        vertical_fov=high,
        width=width,
        height=height,
        near=near,
        far=checks.in_range("far", table["far"], near, _MAX_SIGHT),
    )
