"""Descriptions of robots for process modules and queries: TOML files that are checked against the robot's URDF.

Process modules contain no names of joints, so another robot needs only another TOML file. A description has tables for
the parts of the robot: arms, grippers, a head, a camera, a torso (docs/guides/robots.md).
"""

from __future__ import annotations

import json
import math
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Final

from pycram.foundation import checks, plugins
from pycram.foundation.failures import AssetError, BadArgument, MissingPart, UnknownName
from pycram.models.files import parse_toml, read_text
from recorder import geometry
from recorder.geometry import Pose, PoseLike, Vector
from recorder.urdf import Urdf, UrdfError

_MIN_RATE, _MAX_RATE = 1e-3, 1e3
_MAX_SIGHT: Final = 1e4  # m
_MAX_FOV: Final = 3.1  # rad
_MAX_PIXELS: Final = 1e5

_SIZES: Final = (0.0, 1.0)  # m
_STILL: Final = 1e-4  # maximum motion in m of a fixed link when the gripper closes
_ALONG: Final = math.cos(math.radians(45))  # minimum share along y in the whole motion of a gripper's side
_ACROSS: Final = 0.4  # minimum share of a finger's motion along y; with a smaller share, the finger is on no side
_EVEN: Final = 0.01  # largest bias (:meth:`Gripper.bias`) at which both sides count as equally fast
_AIR: Final = 2e-3  # distance in m between an object and a fixed jaw, more than the engine's padding of shapes


class Misfitting(UserWarning):
    """A robot was loaded without parts of its description, because these parts don't match its URDF."""


@dataclass(frozen=True, slots=True)
class RobotDescription:
    """The description of a robot."""

    robot: str  # name of the robot in the URDF
    base_link: str  # name of the link whose pose is the pose of the robot
    arms: Mapping[str, Arm]  # by name
    head: Head | None
    camera: CameraDescription | None
    torso: Torso | None
    drives: bool  # whether the base can drive
    limits: MotionLimits
    may_touch: frozenset[frozenset[str]]  # pairs of links whose shapes overlap although the real links don't touch
    text: str  # the TOML text of the description
    source: str  # name of the TOML file, for errors

    @classmethod
    def load(cls, path: str | Path) -> RobotDescription:
        """Read a description from a TOML file; raise an AssetError if the file or an entry is invalid."""
        return cls.parse(read_text(Path(path)), str(path))

    @classmethod
    def parse(cls, text: str, source: str = "robot description") -> RobotDescription:
        """Read a description from TOML text; an AssetError names the ``source`` and the invalid entry."""
        table = parse_toml(text, source)
        try:
            keys = "robot", "base_link", "drives", "may_touch", "arms", "head", "camera", "torso", "limits", "without"
            checks.only(table, *keys)
            arms = checks.table(table, "arms") if "arms" in table else {}
            described = cls(
                robot=checks.text("robot", table["robot"]),
                base_link=checks.text("base_link", table["base_link"]),
                arms={checks.text("an arm's name", name): _read_arm(name, checks.table(arms, name)) for name in arms},
                head=_read_head(checks.table(table, "head")) if "head" in table else None,
                camera=_read_camera(checks.table(table, "camera")) if "camera" in table else None,
                torso=_read_torso(checks.table(table, "torso")) if "torso" in table else None,
                drives=checks.switch("drives", table.get("drives", True)),
                limits=_read_limits(checks.table(table, "limits")) if "limits" in table else MotionLimits(),
                may_touch=_pairs(table.get("may_touch", [])),
                text=text,
                source=source,
            )
            return described._without(checks.texts("without", table["without"])) if "without" in table else described
        except KeyError as error:
            raise AssetError(source, f"the description has no entry {error.args[0]}") from error
        except (BadArgument, TypeError) as error:
            raise AssetError(source, str(error)) from error

    def arm(self, name: str) -> Arm:
        """Return an arm by name; raise UnknownName if the robot has no such arm."""
        if name not in self.arms:
            raise UnknownName("arm", name, self.robot, self.arms)
        return self.arms[name]

    def arm_of(self, tool_frame: str) -> Arm | None:
        """Return the arm with a ``tool_frame``; None if no arm has this tool frame."""
        return next((arm for arm in self.arms.values() if arm.tool_frame == tool_frame), None)

    def check(self, urdf: Urdf) -> None:
        """Check the description against the robot's URDF; raise an AssetError for the first of the :meth:`misfits`."""
        for reason in self.misfits(urdf).values():
            raise AssetError(self.source, reason)

    def misfits(self, urdf: Urdf) -> dict[str, str]:
        """Return the parts that don't match a URDF, named as in "torso" or "left arm's pose park", with the reasons."""
        parts: list[tuple[str, Iterable[str], Mapping[str, list[float]]]] = [
            ("base_link", [self.base_link], {}),
            *((_pair_name(pair), sorted(pair), {}) for pair in self.may_touch),
        ]
        if self.camera:
            parts.append(("camera", [self.camera.frame], {}))
        if self.torso:
            parts.append(("torso", [], {self.torso.joint: [self.torso.default]}))
        if self.head:
            parts += ((part, [], {joint: []}) for part, joint in self.head.parts.items() if joint)
        found = {part: reason for part, links, joints in parts if (reason := _misfit(urdf, links, joints))}
        for arm in self.arms.values():
            found |= arm.misfits(urdf)
        return found

    def fitted(self, urdf: Urdf) -> RobotDescription | None:
        """Return the description without the parts that don't match a URDF; None if no part of the robot is left."""
        out = self.misfits(urdf)
        if not out:
            return self
        text = f"without = {json.dumps(list(out), ensure_ascii=False)}\n{self.text}"  # a JSON list is also a TOML list
        rest = self.parse(text, self.source)  # parsed, because recordings contain the text
        return rest if "base_link" not in out and (rest.arms or rest.head or rest.camera or rest.torso) else None

    def _without(self, parts: Sequence[str]) -> RobotDescription:
        """Return the description without parts; ``parts`` are names that :meth:`misfits` returns."""
        head = self.head and Head(*("" if part in parts else joint for part, joint in self.head.parts.items()))
        return replace(
            self,
            arms={name: arm.without(parts) for name, arm in self.arms.items() if f"{name} arm" not in parts},
            head=head if head and head.joints else None,
            camera=None if "camera" in parts else self.camera,
            torso=None if "torso" in parts else self.torso,
            may_touch=frozenset(pair for pair in self.may_touch if _pair_name(pair) not in parts),
        )


def _pair_name(pair: Iterable[str]) -> str:
    return f"may_touch of {' and '.join(sorted(pair))}"


def _misfit(urdf: Urdf, links: Iterable[str], joints: Mapping[str, Iterable[float]]) -> str:
    """Return why links and joint values don't match a URDF; "" if they match."""
    try:
        for link in links:
            urdf.parent_joint(link)
        for name, values in joints.items():
            joint = urdf.joint(name)
            if not joint.movable:
                return f"the description moves the fixed joint {name}"
            for value in values:
                if not joint.lower <= value <= joint.upper:
                    limits = f"{joint.lower:g} to {joint.upper:g}"
                    return f"the description sets {name} to {value:g}, outside the joint's limits {limits}"
    except UrdfError as error:
        return str(error)
    return ""


@dataclass(frozen=True, slots=True)
class Arm:
    """An arm."""

    name: str  # any name, such as "left", "right" or "panda"
    joints: tuple[str, ...]  # names of the joints from the shoulder to the wrist
    base_link: str  # parent link of the first joint
    tool_frame: str  # link to which the tool frame is attached
    tool_offset: Pose  # pose of the tool frame in this link: x points out of the gripper, fingers close along y
    hand: Gripper | None
    poses: Mapping[str, tuple[float, ...]]  # joint values of named postures, in the order of ``joints``

    @property
    def gripper(self) -> Gripper:
        """The gripper; raises MissingPart if the arm has no gripper."""
        if self.hand is None:
            raise MissingPart(f"{self.name} arm", "gripper")
        return self.hand

    def tool_pose(self, link_pose: PoseLike) -> Pose:
        """Return the pose of the tool frame, given the pose of the link ``tool_frame`` in the same frame."""
        return geometry.multiply(link_pose, self.tool_offset)

    def posture(self, name: str) -> dict[str, float]:
        """Return the joint values of a named posture by joint; raise UnknownName for an unknown posture."""
        if name not in self.poses:
            raise UnknownName("named pose", name, f"the {self.name} arm", self.poses)
        return dict(zip(self.joints, self.poses[name], strict=True))

    def links(self) -> list[str]:
        """Return the names of all links in the description of the arm."""
        return [self.base_link, self.tool_frame, *([self.hand.palm, *self.hand.fingers] if self.hand else [])]

    def bias(self, urdf: Urdf) -> float:
        """Return how unevenly the sides of the gripper close, as :meth:`Gripper.bias` defines it."""
        return self.gripper.bias(urdf, self.tool_frame, self.tool_offset)

    def misfits(self, urdf: Urdf) -> dict[str, str]:
        """Return the parts that don't match a URDF, such as "left gripper" or "left arm's pose park", with reasons."""
        arm, hand = f"{self.name} arm", self.hand
        if reason := _misfit(urdf, [self.base_link, self.tool_frame], {joint: [] for joint in self.joints}):
            return {arm: reason}
        try:
            chain = tuple(joint.name for joint in urdf.chain(self.base_link, self.tool_frame) if joint.movable)
        except UrdfError as error:
            return {arm: str(error)}
        if chain != self.joints:
            return {arm: f"the {arm}'s joints from base_link to tool_frame are {', '.join(chain) or 'none'}"}
        postures = {name: {joint: [at] for joint, at in self.posture(name).items()} for name in self.poses}
        found = {f"{arm}'s pose {name}": _misfit(urdf, [], posture) for name, posture in postures.items()}
        if hand:
            ends = {joint: [hand.at(0.0)[joint], hand.at(1.0)[joint]] for joint in hand.joints}
            reason = _misfit(urdf, [hand.palm, *hand.fingers], ends)
            if not reason:
                wrong = next(hand.wrong_ways(urdf, self.tool_frame, self.tool_offset), "")
                reason = wrong and f"the {self.name} gripper: {wrong}; turn the tool frame with tool_offset"
            found[f"{self.name} gripper"] = reason
        return {part: reason for part, reason in found.items() if reason}

    def without(self, parts: Container[str]) -> Arm:
        """Return the arm without parts; ``parts`` are names that :meth:`misfits` returns."""
        poses = {name: row for name, row in self.poses.items() if f"{self.name} arm's pose {name}" not in parts}
        return replace(self, hand=None if f"{self.name} gripper" in parts else self.hand, poses=poses)


@dataclass(frozen=True, slots=True)
class Torso:
    """A torso that moves up and down."""

    joint: str
    default: float  # position of the joint in m for work at tables


@dataclass(frozen=True, slots=True)
class Head:
    """A head that turns the camera."""

    pan: str = ""  # name of the joint that turns the head left and right; "" without such a joint
    tilt: str = ""  # name of the joint that turns the head up and down; "" without such a joint

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the existing joints."""
        return tuple(joint for joint in (self.pan, self.tilt) if joint)

    @property
    def parts(self) -> dict[str, str]:
        """Both joints by the names that :meth:`RobotDescription.misfits` uses for them; "" for a missing joint."""
        return {"head's pan joint": self.pan, "head's tilt joint": self.tilt}


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """A camera."""

    frame: str  # link of the optical frame, whose axes point right (x), down (y) and forward (z)
    offset: Pose  # pose of the optical frame in the link ``frame``
    horizontal_fov: float  # rad
    vertical_fov: float  # rad
    width: int  # pixels
    height: int  # pixels
    near: float  # minimum distance in m of visible objects
    far: float  # maximum distance in m of visible objects

    def pose(self, link_pose: PoseLike) -> Pose:
        """Return the pose of the optical frame, given the pose of the link ``frame`` in the same frame."""
        return geometry.multiply(link_pose, self.offset)


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Default limits of velocities and accelerations."""

    turning_velocity: float = 1.0  # velocity of revolute joints without a velocity limit in the URDF, rad/s
    turning_acceleration: float = 4.0  # acceleration of revolute joints, rad/s^2
    sliding_velocity: float = 0.2  # velocity of prismatic joints without a velocity limit in the URDF, m/s
    sliding_acceleration: float = 0.5  # acceleration of prismatic joints, m/s^2
    base_velocity: float = 0.5  # m/s
    base_acceleration: float = 0.5  # m/s^2
    base_turning_velocity: float = 1.0  # velocity of a base about the vertical axis, rad/s
    base_turning_acceleration: float = 1.0  # acceleration of a base about the vertical axis, rad/s^2


def find_description(urdf: Urdf) -> tuple[RobotDescription | None, Mapping[str, str]]:
    """Return the description of a URDF's robot without misfits, and the misfits (:meth:`RobotDescription.misfits`).

    The description is None if no description has the robot's name, or if no part matches. PyCRAM's descriptions are
    searched before descriptions of other packages (:mod:`pycram.foundation.plugins`).
    """
    description = next((own for own in _own() if own.robot == urdf.name), None)
    if description is None and (other := plugins.load(plugins.ROBOTS, urdf.name)) is not None:
        description = other if isinstance(other, RobotDescription) else RobotDescription.load(other)
    return (None, {}) if description is None else (description.fitted(urdf), description.misfits(urdf))


@cache
def _own() -> tuple[RobotDescription, ...]:
    return tuple(RobotDescription.load(file) for file in sorted(Path(__file__).parent.glob("*.toml")))


def _read_arm(name: str, table: checks.Table) -> Arm:
    checks.only(table, "base_link", "tool_frame", "tool_offset", "joints", "poses", "gripper")
    joints = checks.texts("joints", table["joints"])
    if not joints:
        raise BadArgument("joints", [], "at least one")
    poses: dict[str, tuple[float, ...]] = {}
    for pose, values in checks.table(table, "poses").items() if "poses" in table else ():
        if not isinstance(values, list) or len(values) != len(joints):
            raise BadArgument(f"arms.{name}.poses.{pose}", values, f"{len(joints)} numbers")
        poses[pose] = tuple(checks.number(pose, value) for value in values)
    base_link, tool_frame = (checks.text(key, table[key]) for key in ("base_link", "tool_frame"))
    offset = checks.pose_entry(table, "tool_offset")
    hand = read_gripper(checks.table(table, "gripper")) if "gripper" in table else None
    return Arm(name, joints, base_link, tool_frame, offset, hand, poses)


def _read_head(table: checks.Table) -> Head:
    checks.only(table, "pan", "tilt")
    if not table:
        raise BadArgument("head", table, "the name of a pan joint, of a tilt joint, or of both")
    return Head(**{key: checks.text(key, value) for key, value in table.items()})


def _read_camera(table: checks.Table) -> CameraDescription:
    checks.only(table, "frame", "frame_offset", "horizontal_fov", "vertical_fov", "width", "height", "near", "far")
    wide, high = (checks.in_range(key, table[key], 1e-3, _MAX_FOV) for key in ("horizontal_fov", "vertical_fov"))
    width, height = (int(checks.in_range(key, table[key], 1, _MAX_PIXELS)) for key in ("width", "height"))
    near = checks.in_range("near", table["near"], 1e-4, _MAX_SIGHT)
    return CameraDescription(
        frame=checks.text("frame", table["frame"]),
        offset=checks.pose_entry(table, "frame_offset"),
        horizontal_fov=wide,
        vertical_fov=high,
        width=width,
        height=height,
        near=near,
        far=checks.in_range("far", table["far"], near, _MAX_SIGHT),
    )


def _read_torso(table: checks.Table) -> Torso:
    checks.only(table, "joint", "default")
    return Torso(checks.text("joint", table["joint"]), checks.number("default", table["default"]))


def _read_limits(table: checks.Table) -> MotionLimits:
    checks.only(table, *(field.name for field in fields(MotionLimits)))
    return MotionLimits(**{name: checks.in_range(name, value, _MIN_RATE, _MAX_RATE) for name, value in table.items()})


def _pairs(value: object) -> frozenset[frozenset[str]]:
    if not isinstance(value, list):
        raise BadArgument("may_touch", value, "a list of pairs of links")
    pairs = frozenset(frozenset(checks.texts("may_touch", pair)) for pair in value)
    if any(len(pair) != 2 for pair in pairs):
        raise BadArgument("may_touch", value, "a list of pairs, each of two different links")
    return pairs


@dataclass(frozen=True, slots=True, kw_only=True)
class Gripper:
    """A gripper with fingers; or a suction cup, which has no joints and no fingers."""

    palm: str  # link of the palm or of the suction cup
    joints: tuple[str, ...] = ()  # names of all joints that move the fingers, including mimic joints
    closed: tuple[float, ...] = ()  # position of each joint when closed, rad or m
    open: tuple[float, ...] = ()  # position of each joint when open, rad or m
    fingers: tuple[str, ...] = ()  # names of the fingers' links
    aperture: float = 0.0  # distance in m between the open finger tips
    depth: float = 0.0  # distance in m from the tool frame back to the palm: the room for an object
    tips: float = 0.0  # distance in m from the tool frame forward to the closed finger tips; open fingers are shorter
    underside: float  # distance in m from the tool frame down to the lowest point of a level gripper
    gap: float = 0.0  # distance in m between the closed finger tips; thinner objects slip through
    suction: float = 0.0  # radius in m of the suction cup, whose rim is at the tool frame; 0 for fingers

    def positions(self, motion: str) -> dict[str, float]:
        """Return joint values for the motion "open" or "close"."""
        return self.at(1.0 if motion == "open" else 0.0)

    def at(self, share: float) -> dict[str, float]:
        """Return joint values for a share between closed (0) and open (1)."""
        ends = zip(self.joints, self.closed, self.open, strict=True)
        return {joint: closed + share * (opened - closed) for joint, closed, opened in ends}

    def wrong_ways(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> Iterator[str]:
        """Yield reasons why the fingers don't close from both sides along the y axis of the arm's tool frame.

        A fixed jaw counts as a side. Several fingers of a side may close at angles to y if the sum of their motions is
        along y, as in hands with three fingers around a centre. Shapes aren't checked.
        """
        if self.suction:
            return
        ways = self._ways(urdf, tool_frame, tool_offset)
        moving = {finger: way for finger, way in ways.items() if math.hypot(*way) >= _STILL}
        across = [finger for finger, way in moving.items() if _is_across(way)]
        sides = [[f for f, way in moving.items() if f not in across and way[1] * sign > 0] for sign in (1.0, -1.0)]
        for side in [*filter(None, sides), *([finger] for finger in across)]:
            x, y, z = (sum(ways[finger][axis] for finger in side) for axis in range(3))
            held_by_others = side[0] in across and all(sides) and abs(z) > abs(x)
            if abs(y) < _ALONG * math.hypot(x, y, z) and not held_by_others:
                closing = f"finger {side[0]} closes" if len(side) == 1 else f"fingers {', '.join(side)} close"
                yield f"{closing} along the tool frame's {'x' if abs(x) > abs(z) else 'z'} axis, not along y"
        if self.fingers and not any(sides):
            yield f"the joints {', '.join(self.joints)} don't move the fingers"
        elif self.fingers and not all(sides) and len(moving) == len(ways):
            yield "all fingers close from the same side"

    def jaws(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> list[str]:
        """Return the fingers on the two sides. With four fingers around a centre, some fingers are on no side."""
        ways = self._ways(urdf, tool_frame, tool_offset)
        return [finger for finger, way in ways.items() if math.hypot(*way) < _STILL or not _is_across(way)]

    def bias(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> float:
        """Return how unevenly the sides close, -1 to 1: 0 if both sides move equally far, 1 if only +y moves."""
        ways = [0.0, *(y for _, y, _ in self._ways(urdf, tool_frame, tool_offset).values())]
        left, right = -min(ways), max(ways)
        bias = (left - right) / (left + right) if left + right > _STILL else 0.0
        return bias if abs(bias) > _EVEN else 0.0

    def middle(self, width: float, bias: float) -> float:
        """Return y in the tool frame, in m, of the middle of a grasped object with a width in m."""
        return bias * ((width - self.gap) / 2 + _AIR)

    def _ways(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> dict[str, Vector]:
        """Return how far each finger moves when the gripper closes, in m, measured at the origin of the tool frame."""
        in_tool: list[dict[str, Pose]] = []  # poses of the fingers: open, then closed
        for share in (1.0, 0.0):
            positions = self.at(share)
            inverse = geometry.invert(geometry.multiply(urdf.forward_kinematics(positions, tool_frame), tool_offset))
            in_tool.append({f: geometry.multiply(inverse, urdf.forward_kinematics(positions, f)) for f in self.fingers})
        ways: dict[str, Vector] = {}
        for finger in self.fingers:
            x, y, z = geometry.multiply(in_tool[0][finger], geometry.invert(in_tool[1][finger]))[0]
            ways[finger] = -x, -y, -z
        return ways


def _is_across(way: Vector) -> bool:
    return abs(way[1]) < _ACROSS * math.hypot(*way)


def read_gripper(table: checks.Table) -> Gripper:
    """Return the gripper of a TOML table; raise KeyError for a missing entry, BadArgument for an invalid entry."""
    if "suction" in table:
        checks.only(table, "palm", "suction", "underside")
        return Gripper(
            palm=checks.text("palm", table["palm"]),
            underside=checks.in_range("underside", table["underside"], *_SIZES),
            suction=checks.in_range("suction", table["suction"], 1e-3, 1.0),
        )
    checks.only(table, "palm", "joints", "closed", "open", "fingers", "aperture", "gap", "depth", "tips", "underside")
    joints = checks.texts("joints", table["joints"])
    fingers = checks.texts("fingers", table["fingers"])
    for name, values in (("joints", joints), ("fingers", fingers)):
        if not values:
            raise BadArgument(name, list(values), 'at least one; a suction cup has "suction" instead')
    aperture = checks.in_range("aperture", table["aperture"], 1e-3, 1.0)
    gap = checks.in_range("gap", table.get("gap", 0.0), 0.0, aperture)
    sizes = {key: checks.in_range(key, table[key], *_SIZES) for key in ("depth", "tips", "underside")}
    return Gripper(
        palm=checks.text("palm", table["palm"]),
        joints=joints,
        closed=_values("closed", table["closed"], joints),
        open=_values("open", table["open"], joints),
        fingers=fingers,
        aperture=aperture,
        gap=gap,
        **sizes,
    )


def _values(key: str, value: object, joints: tuple[str, ...]) -> tuple[float, ...]:
    """Return a value for each joint from a list of values, or from a single value for all joints."""
    if not isinstance(value, list):
        return (checks.number(key, value),) * len(joints)
    if len(value) != len(joints):
        raise BadArgument(key, value, f"a number, or {len(joints)} numbers for {', '.join(joints)}")
    return tuple(checks.number(key, item) for item in value)
