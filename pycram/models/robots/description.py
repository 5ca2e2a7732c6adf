"""What process modules and queries have to know of a robot, checked against its URDF.

A process module never holds the name or number of a joint: a second robot is a second TOML file.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.foundation import checks
from pycram.foundation.failures import AssetError, BadArgument, UnknownName
from pycram.models.files import parse_toml, read_text
from pycram.models.robots import tables
from recorder.geometry.joints import UrdfError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.geometry.urdf import Urdf

_MAX_SIGHT: Final = 1e4  # m
_MAX_FOV: Final = 3.1  # rad
_MAX_PIXELS: Final = 1e5


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
        """Return joint values for the motion "open" or "close"."""
        return self.at(1.0 if motion == "open" else 0.0)

    def at(self, share: float) -> dict[str, float]:
        """Return joint values for a share between closed (0) and open (1)."""
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
        """Return the joint values of a named posture.

        Raises:
            UnknownName: The arm has none of that name.
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
        text: the TOML that it was read from.
        source: the TOML's file, for errors.
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
            tables.only(table, "robot", "base_link", "arms", "head", "camera", "torso")
            arms = tables.table(table, "arms")
            return cls(
                robot=checks.text("robot", table["robot"]),
                base_link=checks.text("base_link", table["base_link"]),
                arms={name: _arm(name, tables.table(arms, name)) for name in arms},
                head=tables.record(Head, tables.table(table, "head")) if "head" in table else None,
                camera=_camera(tables.table(table, "camera")) if "camera" in table else None,
                torso=tables.record(Torso, tables.table(table, "torso")) if "torso" in table else None,
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
        """Return the arm with a tool frame; None if there is none."""
        return next((arm for arm in self.arms.values() if arm.tool_frame == tool_frame), None)

    def check(self, urdf: Urdf) -> None:
        """Check that all names and values fit the robot's URDF.

        Raises:
            AssetError: A joint or link doesn't exist, a chain isn't one, or a value is outside limits.
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
        """Return all links that it names."""
        links = [self.base_link] + ([self.camera.frame] if self.camera else [])
        for arm in self.arms.values():
            links += [arm.base_link, arm.tool_frame, arm.gripper.palm, *arm.gripper.fingers]
        return links

    def _values(self) -> dict[str, list[float]]:
        """Return all joints that it names, with all values that it has for them."""
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
            found = ", ".join(chain)
            raise AssetError(self.source, f"the {arm.name} arm's joints from base_link to tool_frame are {found}")


@cache
def find_description(robot: str) -> RobotDescription | None:
    """Return PyCRAM's own description of a robot, by the name in its URDF; None if there is none."""
    descriptions = (RobotDescription.load(file) for file in sorted(Path(__file__).parent.glob("*.toml")))
    return next((description for description in descriptions if description.robot == robot), None)


def _camera(table: tables.Table) -> CameraDescription:
    fov, pixels, sight = (1e-3, _MAX_FOV), (1, _MAX_PIXELS), (1e-4, _MAX_SIGHT)
    camera = tables.record(
        CameraDescription,
        table,
        horizontal_fov=fov,
        vertical_fov=fov,
        width=pixels,
        height=pixels,
        near=sight,
        far=sight,
    )
    checks.in_range("far", camera.far, camera.near)
    return camera


def _arm(name: str, table: tables.Table) -> Arm:
    tables.only(table, "base_link", "tool_frame", "joints", "poses", "gripper")
    joints = tables.texts("joints", table["joints"])
    poses: dict[str, tuple[float, ...]] = {}
    for pose, values in tables.table(table, "poses").items():
        if not isinstance(values, list) or len(values) != len(joints):
            raise BadArgument(f"arms.{name}.poses.{pose}", values, f"{len(joints)} numbers")
        poses[pose] = tuple(checks.number(pose, value) for value in values)
    size = (0.0, 1.0)
    gripper = tables.record(
        Gripper, tables.table(table, "gripper"), aperture=(1e-3, 1.0), depth=size, tips=size, underside=size
    )
    base_link, tool_frame = (checks.text(key, table[key]) for key in ("base_link", "tool_frame"))
    return Arm(name, joints, base_link, tool_frame, gripper, poses)
