"""A joint of a URDF: its limits and its kinematics.

Lengths are metres, angles radians, velocities per second; poses are ``(position, quaternion xyzw)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from recorder import geometry
from recorder.geometry import IDENTITY, Pose, Vector

if TYPE_CHECKING:
    import xml.etree.ElementTree as ET

_KINDS: Final = ("fixed", "revolute", "continuous", "prismatic")
_CHAINS: Final = ("planar", "floating")  # which become chains of the others


class UrdfError(ValueError):
    """A URDF is no tree of links, or doesn't have a name.

    Attributes:
        robot: name of the robot.
        reason: what is wrong.
    """

    def __init__(self, robot: str, reason: str) -> None:
        super().__init__(f"URDF {robot!r}: {reason}" if robot else f"URDF: {reason}")
        self.robot = robot
        self.reason = reason


class Mimic(NamedTuple):
    """That a joint follows another: its value is ``multiplier * value of the leader + offset``.

    Attributes:
        leader: name of the joint that it follows.
        multiplier: without a unit, or m/rad or rad/m.
        offset: in rad or m.
    """

    leader: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint:
    """The connection of a link to its parent.

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
        mimic: what it follows, if anything.
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
        """Whether it isn't fixed."""
        return self.type != "fixed"

    def pose(self, value: float) -> Pose:
        """Pose of the child link in the parent link, for a joint value in rad or m."""
        if self.type == "fixed":
            return self.origin
        if self.type == "prismatic":
            x, y, z = self.axis
            return geometry.transform(self.origin, (x * value, y * value, z * value)), self.origin[1]
        half = value / 2.0
        s = math.sin(half)
        x, y, z = self.axis
        return self.origin[0], geometry.product(self.origin[1], (x * s, y * s, z * s, math.cos(half)))


def read_joint(robot: str, element: ET.Element, *, chains: bool = False) -> Joint:
    """Reads the element of a joint.

    Args:
        robot: its name.
        element: the joint's.
        chains: whether it may be planar or floating.

    Raises:
        UrdfError: something is missing, or no number.
    """
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
        position = _numbers(robot, name, "origin xyz", origin.get("xyz", "0 0 0"))
        roll, pitch, yaw = _numbers(robot, name, "origin rpy", origin.get("rpy", "0 0 0"))
        pose = (position, geometry.from_rpy(roll, pitch, yaw))
    lower, upper, effort, velocity = _limits(robot, name, kind, element.find("limit"))
    return Joint(
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
        mimic=_mimic(robot, name, element) if kind != "fixed" else None,
    )


def _mimic(robot: str, joint: str, element: ET.Element) -> Mimic | None:
    mimic = element.find("mimic")
    if mimic is None:
        return None
    multiplier = _number(robot, joint, "mimic multiplier", mimic.get("multiplier", "1"))
    return Mimic(mimic.get("joint", ""), multiplier, _number(robot, joint, "mimic offset", mimic.get("offset", "0")))


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
    """Return the number that a URDF's text is for any reader: Python also takes 1_0, and digits of other scripts.

    Raises:
        ValueError: It isn't one, or isn't finite.
    """
    value = float(text)
    if not math.isfinite(value) or "_" in text or not text.isascii():
        raise ValueError(text)
    return value


def _numbers(robot: str, joint: str, what: str, text: str) -> Vector:
    parts = text.split()
    if len(parts) != 3:
        raise UrdfError(robot, f"{what} of joint {joint} is {text!r}, not three numbers")
    x, y, z = (_number(robot, joint, what, part) for part in parts)
    return x, y, z
