"""What process modules and queries have to know of a robot, read from TOML and checked against its URDF.

A process module never holds the name or number of a joint: a second robot is a second file.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

from pycram.foundation import checks, toml
from pycram.foundation.failures import AssetError, BadArgument, UnknownName
from recorder.geometry.joints import UrdfError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from recorder.geometry.urdf import Urdf

T = TypeVar("T")
_FARTHEST: Final = 1e4  # m
_WIDEST: Final = 3.1  # rad
_MOST_PIXELS: Final = 1e5


@dataclass(frozen=True, slots=True)
class Gripper:
    """A parallel gripper.

    Attributes:
        joints: all joints that move with its fingers.
        closed: their value when closed, rad or m.
        open: their value when open.
        palm: link of the palm.
        fingers: links of the fingers.
        aperture: m between the finger tips when open.
        depth: m that it may take in of an object, from the tool frame back towards the palm.
        tips: m from the tool frame on to the finger tips when closed; open ones reach less far.
        underside: m from the tool frame down to the gripper's lowest point when it lies level.
    """

    joints: tuple[str, ...]
    closed: float
    open: float
    palm: str
    fingers: tuple[str, ...]
    aperture: float
    depth: float
    tips: float
    underside: float

    def positions(self, motion: str) -> dict[str, float]:
        """Joint values for "open" or "close"."""
        return self.at(1.0 if motion == "open" else 0.0)

    def at(self, share: float) -> dict[str, float]:
        """Joint values between closed (0) and open (1)."""
        return dict.fromkeys(self.joints, self.closed + share * (self.open - self.closed))


@dataclass(frozen=True, slots=True)
class Arm:
    """An arm.

    Attributes:
        name: "left", "right", ...
        joints: its joints from the shoulder on.
        base_link: the link that its first joint hangs on.
        tool_frame: x points out of the gripper, the fingers close along y.
        gripper: its gripper.
        poses: named postures, values in the order of the joints.
    """

    name: str
    joints: tuple[str, ...]
    base_link: str
    tool_frame: str
    gripper: Gripper
    poses: Mapping[str, tuple[float, ...]]

    def posture(self, name: str) -> dict[str, float]:
        """Joint values of a named posture.

        Raises:
            UnknownName: the arm has none of that name.
        """
        if name not in self.poses:
            raise UnknownName("named pose", name, f"the {self.name} arm", self.poses)
        return dict(zip(self.joints, self.poses[name], strict=True))


@dataclass(frozen=True, slots=True)
class Head:
    """A pan-tilt head: names of its two joints."""

    pan: str
    tilt: str


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """A camera.

    Attributes:
        frame: its optical frame, z forward, x right, y down.
        horizontal_fov: field of view in rad.
        vertical_fov: field of view in rad.
        width: pixels.
        height: pixels.
        near: m from which on it sees.
        far: m up to which it sees.
    """

    frame: str
    horizontal_fov: float
    vertical_fov: float
    width: int
    height: int
    near: float
    far: float


@dataclass(frozen=True, slots=True)
class Torso:
    """A torso that lifts.

    Attributes:
        joint: its joint.
        default: value for work at tables, m.
    """

    joint: str
    default: float


@dataclass(frozen=True, slots=True)
class RobotDescription:
    """A robot.

    Attributes:
        robot: name in its URDF.
        base_link: the link that poses of the robot are poses of.
        arms: by name.
        head: its head, if it has one that turns.
        camera: its camera, if it has one.
        torso: its torso, if it lifts.
        text: the TOML that says all this.
        source: where that came from, for errors.
    """

    robot: str
    base_link: str
    arms: Mapping[str, Arm]
    head: Head | None
    camera: CameraDescription | None
    torso: Torso | None
    text: str
    source: str

    @classmethod
    def load(cls, path: str | Path) -> RobotDescription:
        """Reads a description.

        Args:
            path: a TOML file.

        Raises:
            AssetError: it can't be read, or says too little.
        """
        file = Path(path)
        try:
            text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise AssetError(file, f"can't be read: {error}") from error
        return cls.parse(text, str(file))

    @classmethod
    def parse(cls, text: str, source: str = "robot description") -> RobotDescription:
        """Reads a description from text.

        Args:
            text: the TOML.
            source: where it came from, for errors.

        Raises:
            AssetError: it isn't TOML, or says too little.
        """
        tables = toml.parse(text, source)
        try:
            _only(tables, "robot", "base_link", "arms", "head", "camera", "torso")
            return cls(
                robot=_text(tables, "robot"),
                base_link=_text(tables, "base_link"),
                arms={name: _arm(name, _table(arms, name)) for arms in [_table(tables, "arms")] for name in arms},
                head=_optional(tables, "head", lambda head: Head(_text(head, "pan"), _text(head, "tilt"))),
                camera=_optional(tables, "camera", _camera),
                torso=_optional(tables, "torso", lambda torso: Torso(_text(torso, "joint"), _number(torso, "default"))),
                text=text,
                source=source,
            )
        except KeyError as error:
            raise AssetError(source, f"has no entry {error.args[0]}") from error
        except (BadArgument, TypeError) as error:
            raise AssetError(source, str(error)) from error

    def arm(self, name: str) -> Arm:
        """An arm by name.

        Raises:
            UnknownName: it has no such arm.
        """
        if name not in self.arms:
            raise UnknownName("arm", name, self.robot, self.arms)
        return self.arms[name]

    def arm_of(self, tool_frame: str) -> Arm | None:
        """The arm with that tool frame."""
        return next((arm for arm in self.arms.values() if arm.tool_frame == tool_frame), None)

    def check(self, urdf: Urdf) -> None:
        """Makes sure that all names and values fit a robot.

        Args:
            urdf: its URDF.

        Raises:
            AssetError: a joint or link doesn't exist, a chain isn't one, or a value is outside limits.
        """
        try:
            for link in self._links():
                urdf.parent_joint(link)
            for name, values in self._values().items():
                joint = urdf.joint(name)
                for value in values:
                    if not joint.lower <= value <= joint.upper:
                        limits = f"{joint.lower:g} to {joint.upper:g}"
                        raise AssetError(self.source, f"puts {name} to {value:g}, outside of its limits {limits}")
            for arm in self.arms.values():
                self._check_chain(arm, urdf)
        except UrdfError as error:
            raise AssetError(self.source, str(error)) from error

    def _links(self) -> list[str]:
        """All links that it names."""
        links = [self.base_link] + ([self.camera.frame] if self.camera else [])
        for arm in self.arms.values():
            links += [arm.base_link, arm.tool_frame, arm.gripper.palm, *arm.gripper.fingers]
        return links

    def _values(self) -> dict[str, list[float]]:
        """All joints that it names, with the values that it would put them to."""
        values: dict[str, list[float]] = {}
        if self.head:
            values |= {self.head.pan: [], self.head.tilt: []}
        if self.torso:
            values[self.torso.joint] = [self.torso.default]
        for arm in self.arms.values():
            values |= {joint: [posture[i] for posture in arm.poses.values()] for i, joint in enumerate(arm.joints)}
            values |= {joint: [arm.gripper.open, arm.gripper.closed] for joint in arm.gripper.joints}
        return values

    def _check_chain(self, arm: Arm, urdf: Urdf) -> None:
        chain = tuple(joint.name for joint in urdf.chain(arm.base_link, arm.tool_frame) if joint.movable)
        if chain != arm.joints:
            told = ", ".join(chain)
            raise AssetError(self.source, f"the {arm.name} arm's joints from base_link to tool_frame are {told}")


def _table(tables: Mapping[str, object], key: str) -> dict[str, object]:
    value = tables[key]
    if not isinstance(value, dict):
        raise BadArgument(key, value, "a table")
    return value


def _text(table: Mapping[str, object], key: str) -> str:
    return checks.text(key, table[key])


def _number(table: Mapping[str, object], key: str) -> float:
    return checks.number(key, table[key])


def _between(table: Mapping[str, object], key: str, low: float, high: float) -> float:
    value = _number(table, key)
    if not low <= value <= high:
        raise BadArgument(key, value, f"a number from {low:g} to {high:g}")
    return value


def _only(table: Mapping[str, object], *keys: str) -> None:
    for key in table:
        if key not in keys:
            raise BadArgument(key, table[key], f"only {', '.join(keys)} here")


def _texts(table: Mapping[str, object], key: str) -> tuple[str, ...]:
    value = table[key]
    if not isinstance(value, list):
        raise BadArgument(key, value, "a list of names")
    return tuple(checks.text(key, item) for item in value)


def _optional(tables: Mapping[str, object], key: str, read: Callable[[dict[str, object]], T]) -> T | None:
    return read(_table(tables, key)) if key in tables else None


def _camera(table: dict[str, object]) -> CameraDescription:
    _only(table, "frame", "horizontal_fov", "vertical_fov", "width", "height", "near", "far")
    near = _between(table, "near", 1e-4, _FARTHEST)
    return CameraDescription(
        frame=_text(table, "frame"),
        horizontal_fov=_between(table, "horizontal_fov", 1e-3, _WIDEST),
        vertical_fov=_between(table, "vertical_fov", 1e-3, _WIDEST),
        width=int(_between(table, "width", 1, _MOST_PIXELS)),
        height=int(_between(table, "height", 1, _MOST_PIXELS)),
        near=near,
        far=_between(table, "far", near, _FARTHEST),
    )


def _arm(name: str, table: dict[str, object]) -> Arm:
    gripper = _table(table, "gripper")
    _only(table, "base_link", "tool_frame", "joints", "poses", "gripper")
    _only(gripper, "joints", "closed", "open", "palm", "fingers", "aperture", "depth", "tips", "underside")
    joints = _texts(table, "joints")
    poses: dict[str, tuple[float, ...]] = {}
    for pose, values in _table(table, "poses").items():
        if not isinstance(values, list) or len(values) != len(joints):
            raise BadArgument(f"arms.{name}.poses.{pose}", values, f"{len(joints)} numbers")
        poses[pose] = tuple(checks.number(pose, value) for value in values)
    return Arm(
        name=name,
        joints=joints,
        base_link=_text(table, "base_link"),
        tool_frame=_text(table, "tool_frame"),
        gripper=Gripper(
            joints=_texts(gripper, "joints"),
            closed=_number(gripper, "closed"),
            open=_number(gripper, "open"),
            palm=_text(gripper, "palm"),
            fingers=_texts(gripper, "fingers"),
            aperture=_between(gripper, "aperture", 1e-3, 1.0),
            depth=_between(gripper, "depth", 0.0, 1.0),
            tips=_between(gripper, "tips", 0.0, 1.0),
            underside=_between(gripper, "underside", 0.0, 1.0),
        ),
        poses=poses,
    )


@cache
def find_description(robot: str) -> RobotDescription | None:
    """The description that PyCRAM has of a robot.

    Args:
        robot: its name in its URDF.
    """
    for file in sorted(Path(__file__).parent.glob("*.toml")):
        description = RobotDescription.load(file)
        if description.robot == robot:
            return description
    return None
