"""What process modules and queries have to know of a robot, checked against its URDF.

A process module never holds the name or number of a joint: a second robot is a second TOML file. What a robot doesn't
have, its description leaves out: arms, grippers, a head, a camera, a torso (docs/robots.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from pycram.foundation import checks
from pycram.foundation.failures import AssetError, BadArgument, UnknownName
from pycram.models.files import parse_toml, read_text
from pycram.models.robots import tables
from pycram.models.robots.arm import Arm, read_arm
from pycram.models.robots.gripper import Gripper
from pycram.models.robots.limits import MotionLimits, read_limits
from pycram.models.robots.sensors import CameraDescription, Head, read_camera, read_head
from pycram.models.warming import notable
from recorder.urdf import UrdfError

if TYPE_CHECKING:
    from collections.abc import Mapping

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
        drives: whether its base does; else it stays where it was loaded.
        limits: how fast it may move.
        may_touch: pairs of its own links that may overlap, as their shapes do where the robot itself doesn't.
        text: the TOML that it was read from.
        source: the TOML's file, for errors.
    """

    robot: str
    base_link: str
    arms: Mapping[str, Arm]
    head: Head | None
    camera: CameraDescription | None
    torso: Torso | None
    drives: bool
    limits: MotionLimits
    may_touch: frozenset[frozenset[str]]
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
