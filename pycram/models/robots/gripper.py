"""Grippers as data: fingers that close along the tool frame's y axis, or a suction cup on its x axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument
from pycram.models.robots import tables
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.geometry import Pose, Vector
    from recorder.geometry.urdf import Urdf

_SIZES: Final = (0.0, 1.0)  # m
_STILL: Final = 1e-4  # m that a link moves at most that isn't moved by closing
_ALONG: Final = math.cos(math.radians(45))  # of a finger's way that leads along y


@dataclass(frozen=True, slots=True)
class Gripper:
    """A gripper with fingers, or a suction cup, which has no joints and no fingers.

    Attributes:
        palm: link of the palm; of a suction cup, the link of the cup.
        joints: all joints that move with its fingers, those that mimic others too.
        closed: the value of each when closed, rad or m.
        open: the value of each when open.
        fingers: links of the fingers.
        aperture: m between the finger tips when open.
        gap: m between them when closed: thinner things slip through.
        depth: m that it may take in of an object, from the tool frame back towards the palm.
        tips: m from the tool frame on to the finger tips when closed; open ones reach less far.
        underside: m from the tool frame down to the gripper's lowest point when it lies level.
        suction: radius of the cup in m, whose rim is at the tool frame; 0 for fingers.
    """

    palm: str
    joints: tuple[str, ...]
    closed: tuple[float, ...]
    open: tuple[float, ...]
    fingers: tuple[str, ...]
    aperture: float
    depth: float
    tips: float
    underside: float
    gap: float = 0.0
    suction: float = 0.0

    def positions(self, motion: str) -> dict[str, float]:
        """Return joint values for the motion "open" or "close"."""
        return self.at(1.0 if motion == "open" else 0.0)

    def at(self, share: float) -> dict[str, float]:
        """Return joint values for a share between closed (0) and open (1)."""
        ends = zip(self.joints, self.closed, self.open, strict=True)
        return {joint: closed + share * (opened - closed) for joint, closed, opened in ends}

    def wrong_ways(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> Iterator[str]:
        """Yield what is wrong with how the fingers close: they have to, from both sides, along the tool frame's y axis.

        A finger that stands still is one side. Only the kinematics are looked at; what is between the fingers, the
        whole check (``pycram describe --check``) looks at.

        Args:
            urdf: of the robot.
            tool_frame: the link with the tool frame.
            tool_offset: pose of the tool frame in it.
        """
        if self.suction:
            return
        sides: set[float] = set()
        for finger in self.fingers:
            x, y, z = way = self._closing(urdf, tool_frame, tool_offset, finger)
            length = math.hypot(*way)
            if length < _STILL:
                sides.add(0.0)
            elif abs(y) < _ALONG * length:
                axis = "x" if abs(x) > abs(z) else "z"
                yield f"its finger {finger} closes along the tool frame's {axis} axis, not along y"
            else:
                sides.add(math.copysign(1.0, y))
        if self.fingers and not sides - {0.0}:
            yield f"its joints {', '.join(self.joints)} move none of its fingers"
        elif self.fingers and len(sides) < 2:
            yield "its fingers all close from one side"

    def _closing(self, urdf: Urdf, tool_frame: str, tool_offset: Pose, finger: str) -> Vector:
        """Return the way in m, in the tool frame, that a finger's point has gone which is at its origin when closed."""
        opened, closed = (self._finger_in_tool(urdf, tool_frame, tool_offset, finger, share) for share in (1.0, 0.0))
        x, y, z = geometry.multiply(opened, geometry.invert(closed))[0]
        return -x, -y, -z

    def _finger_in_tool(self, urdf: Urdf, tool_frame: str, tool_offset: Pose, finger: str, share: float) -> Pose:
        positions = self.at(share)
        tool = geometry.multiply(urdf.forward_kinematics(positions, tool_frame), tool_offset)
        return geometry.multiply(geometry.invert(tool), urdf.forward_kinematics(positions, finger))


def read_gripper(table: tables.Table) -> Gripper:
    """Return the gripper of a TOML table, checked.

    Raises:
        KeyError: An entry is missing.
        BadArgument: An entry is unknown or impossible.
    """
    if "suction" in table:
        tables.only(table, "palm", "suction", "underside")
        return Gripper(
            palm=checks.text("palm", table["palm"]),
            joints=(),
            closed=(),
            open=(),
            fingers=(),
            aperture=0.0,
            depth=0.0,
            tips=0.0,
            underside=checks.in_range("underside", table["underside"], *_SIZES),
            suction=checks.in_range("suction", table["suction"], 1e-3, 1.0),
        )
    tables.only(table, "palm", "joints", "closed", "open", "fingers", "aperture", "gap", "depth", "tips", "underside")
    joints = tables.texts("joints", table["joints"])
    fingers = tables.texts("fingers", table["fingers"])
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
    """Return a value for each joint, given as one for all of them or as a list."""
    if not isinstance(value, list):
        return (checks.number(key, value),) * len(joints)
    if len(value) != len(joints):
        raise BadArgument(key, value, f"a number, or {len(joints)} numbers for {', '.join(joints)}")
    return tuple(checks.number(key, item) for item in value)
