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
    from recorder.urdf import Urdf

_SIZES: Final = (0.0, 1.0)  # m
_STILL: Final = 1e-4  # m that a link moves at most that isn't moved by closing
_ALONG: Final = math.cos(math.radians(45))  # of a side's way that leads along y
_ACROSS: Final = 0.4  # of a finger's way; if less of it leads along y, the finger is on neither side
_EVEN: Final = 0.01  # of the way: both sides close alike
_AIR: Final = 2e-3  # m to a jaw that stands still: the engine pads shapes by less


@dataclass(frozen=True, slots=True)
class Gripper:
    """A gripper with fingers, or a suction cup, which has no joints and no fingers."""

    palm: str  # link of the palm; of a suction cup, the link of the cup
    joints: tuple[str, ...]  # all joints that move with its fingers, those that mimic others too
    closed: tuple[float, ...]  # the value of each when closed, rad or m
    open: tuple[float, ...]  # the value of each when open
    fingers: tuple[str, ...]  # links of the fingers
    aperture: float  # m between the finger tips when open
    depth: float  # m that it may take in of an object, from the tool frame back towards the palm
    tips: float  # m from the tool frame on to the finger tips when closed; open ones reach less far
    underside: float  # m from the tool frame down to the gripper's lowest point when it lies level
    gap: float = 0.0  # m between them when closed: thinner things slip through
    suction: float = 0.0  # radius of the cup in m, whose rim is at the tool frame; 0 for fingers

    def positions(self, motion: str) -> dict[str, float]:
        """Return joint values for the motion "open" or "close"."""
        return self.at(1.0 if motion == "open" else 0.0)

    def at(self, share: float) -> dict[str, float]:
        """Return joint values for a share between closed (0) and open (1)."""
        ends = zip(self.joints, self.closed, self.open, strict=True)
        return {joint: closed + share * (opened - closed) for joint, closed, opened in ends}

    def wrong_ways(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> Iterator[str]:
        """Yield what is wrong with how the fingers close: they have to, from both sides, along the tool frame's y axis.

        A jaw that stands still is one side. Several fingers of one side may close at angles to y if they do along y
        together, as of hands with three fingers around a centre. Only the kinematics are looked at; what is between
        the fingers, the whole check (``pycram describe --check``) looks at.

        Args:
            urdf: of the robot.
            tool_frame: the link with the tool frame.
            tool_offset: pose of the tool frame in it.
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
                yield f"its {closing} along the tool frame's {'x' if abs(x) > abs(z) else 'z'} axis, not along y"
        if self.fingers and not any(sides):
            yield f"its joints {', '.join(self.joints)} move none of its fingers"
        elif self.fingers and not all(sides) and len(moving) == len(ways):
            yield "its fingers all close from one side"

    def jaws(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> list[str]:
        """Return the fingers that are on one of both sides, as not all of a hand with four around a centre are."""
        ways = self._ways(urdf, tool_frame, tool_offset)
        return [finger for finger, way in ways.items() if math.hypot(*way) < _STILL or not _is_across(way)]

    def bias(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> float:
        """Return how unevenly its sides close: what the fingers on the +y side go more than the others, -1 to 1.

        It is 1 where one jaw on that side is all that moves, and 0 where both sides go as far. Arguments as for
        :meth:`wrong_ways`.
        """
        ways = [0.0, *(y for _, y, _ in self._ways(urdf, tool_frame, tool_offset).values())]
        left, right = -min(ways), max(ways)
        bias = (left - right) / (left + right) if left + right > _STILL else 0.0
        return bias if abs(bias) > _EVEN else 0.0

    def middle(self, width: float, bias: float) -> float:
        """Return y in the tool frame, m, of the middle of something of a width in m when the fingers close on it."""
        return bias * ((width - self.gap) / 2 + _AIR)

    def _ways(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> dict[str, Vector]:
        return {finger: self._closing(urdf, tool_frame, tool_offset, finger) for finger in self.fingers}

    def _closing(self, urdf: Urdf, tool_frame: str, tool_offset: Pose, finger: str) -> Vector:
        """Return the way in m, in the tool frame, that a finger's point has gone which is at its origin when closed."""
        opened, closed = (self._finger_in_tool(urdf, tool_frame, tool_offset, finger, share) for share in (1.0, 0.0))
        x, y, z = geometry.multiply(opened, geometry.invert(closed))[0]
        return -x, -y, -z

    def _finger_in_tool(self, urdf: Urdf, tool_frame: str, tool_offset: Pose, finger: str, share: float) -> Pose:
        positions = self.at(share)
        tool = geometry.multiply(urdf.forward_kinematics(positions, tool_frame), tool_offset)
        return geometry.multiply(geometry.invert(tool), urdf.forward_kinematics(positions, finger))


def _is_across(way: Vector) -> bool:
    return abs(way[1]) < _ACROSS * math.hypot(*way)


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
