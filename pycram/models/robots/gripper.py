"""Descriptions of grippers: fingers that close along the tool frame's y axis, or a suction cup on its x axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.geometry import Pose, Vector
    from recorder.urdf import Urdf

_SIZES: Final = (0.0, 1.0)  # m
_STILL: Final = 1e-4  # m, maximum motion of a link that closing doesn't move
_ALONG: Final = math.cos(math.radians(45))  # minimum share of a side's motion along y
_ACROSS: Final = 0.4  # share of a finger's motion along y, below which the finger is on neither side
_EVEN: Final = 0.01  # maximum bias of sides that close evenly
_AIR: Final = 2e-3  # m, distance from a jaw that stands still: the engine pads shapes by less


@dataclass(frozen=True, slots=True)
class Gripper:
    """A gripper with fingers, or a suction cup, which has no joints and no fingers."""

    palm: str  # link of the palm, or of the suction cup
    joints: tuple[str, ...]  # all joints that move the fingers, including mimic joints
    closed: tuple[float, ...]  # position of each joint when closed, rad or m
    open: tuple[float, ...]  # position of each joint when open, rad or m
    fingers: tuple[str, ...]  # links of the fingers
    aperture: float  # m between the finger tips when open
    depth: float  # m from the tool frame back towards the palm, in which an object fits
    tips: float  # m from the tool frame forward to the finger tips when closed; open fingers reach less far
    underside: float  # m from the tool frame down to the gripper's lowest point when it is level
    gap: float = 0.0  # m between the finger tips when closed; thinner objects slip through
    suction: float = 0.0  # m, radius of the cup, whose rim is at the tool frame; 0 for fingers

    def positions(self, motion: str) -> dict[str, float]:
        """Return joint values for the motion "open" or "close"."""
        return self.at(1.0 if motion == "open" else 0.0)

    def at(self, share: float) -> dict[str, float]:
        """Return joint values for a share between closed (0) and open (1)."""
        ends = zip(self.joints, self.closed, self.open, strict=True)
        return {joint: closed + share * (opened - closed) for joint, closed, opened in ends}

    def wrong_ways(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> Iterator[str]:
        """Yield reasons why the fingers don't close from both sides along the tool frame's y axis.

        A jaw that stands still is a side. Several fingers of a side may close at angles to y if their sum is along y,
        as in hands with three fingers around a centre. Only the kinematics are checked; ``pycram describe --check``
        also checks shapes.

        Args:
            urdf: The robot's URDF.
            tool_frame: The link with the tool frame.
            tool_offset: Pose of the tool frame in that link.
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
        """Return the fingers on either side; in a hand with four fingers around a centre, some are on neither."""
        ways = self._ways(urdf, tool_frame, tool_offset)
        return [finger for finger, way in ways.items() if math.hypot(*way) < _STILL or not _is_across(way)]

    def bias(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> float:
        """Return how unevenly the sides close, -1 to 1; arguments as for :meth:`wrong_ways`.

        The bias is 0 if both sides move equally far, and 1 if only fingers on the +y side move.
        """
        ways = [0.0, *(y for _, y, _ in self._ways(urdf, tool_frame, tool_offset).values())]
        left, right = -min(ways), max(ways)
        bias = (left - right) / (left + right) if left + right > _STILL else 0.0
        return bias if abs(bias) > _EVEN else 0.0

    def middle(self, width: float, bias: float) -> float:
        """Return y in the tool frame, m, of the middle of an object of a width in m when the fingers close on it."""
        return bias * ((width - self.gap) / 2 + _AIR)

    def _ways(self, urdf: Urdf, tool_frame: str, tool_offset: Pose) -> dict[str, Vector]:
        """Return the motion of each finger's point that is at the tool frame's origin when closed, in m."""
        in_tool: list[dict[str, Pose]] = []  # poses of the fingers, open and closed
        for share in (1.0, 0.0):
            positions = self.at(share)
            tool = geometry.multiply(urdf.forward_kinematics(positions, tool_frame), tool_offset)
            inverse = geometry.invert(tool)
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
    """Return a value for each joint: given as a list, or as a single value for all joints."""
    if not isinstance(value, list):
        return (checks.number(key, value),) * len(joints)
    if len(value) != len(joints):
        raise BadArgument(key, value, f"a number, or {len(joints)} numbers for {', '.join(joints)}")
    return tuple(checks.number(key, item) for item in value)
