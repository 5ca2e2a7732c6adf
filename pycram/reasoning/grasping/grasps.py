"""Candidates for grasps: the sides and positions from which a gripper can take an object.

Ray casts find candidates: from the front, the top, the left and the right if the object fits between the fingers,
otherwise from the top over the object's rim. If the object is turned or leans, the gripper turns with the object.
:mod:`pycram.reasoning.grasping.choice` chooses a candidate.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

import numpy as np

from pycram.foundation import checks
from pycram.foundation.failures import UnknownName
from pycram.models.furniture import distinct
from pycram.models.shapes import solids_of
from pycram.reasoning.choosing import UNRECORDED, Choice
from pycram.reasoning.collision.ray_cast import RayCaster, Scan, half_extent
from pycram.reasoning.rejections import Misfit, Uneven
from recorder import geometry
from recorder.geometry import IDENTITY, Pose, Quaternion, Vector

if TYPE_CHECKING:
    from pycram.models.robots.description import Arm
    from pycram.world.object import Object

FREE: Final = 0.004  # part of the aperture in m that must stay free
_CLEARANCE: Final = 0.002  # distance in m between the finger tips and the support of the object
_PADS: Final = (-0.01, 0.0, 0.01)  # offsets of rays across the finger pads, m
_STEP: Final = 0.004  # distance in m between rays along the fingers
_LEVELS: Final = 6  # number of heights below a rim at which the wall is measured
_EDGE: Final = 0.004  # depth in m below a rim at which its wall begins
_UPRIGHT: Final = 0.7  # minimum vertical component of an upright unit axis
_FLAT: Final = 0.002  # largest unevenness in m of the surface below a suction cup
_SKEW: Final = math.radians(2)  # maximum ignored angle in rad between gripper and object
_LONG: Final = 2.0  # ratio of length and width of a long object
_BESIDE: Final = 0.01  # minimum distance in m of off-center grasps from a long object's middle, seen from the top
_LEANING: Final = math.radians(5)  # if an object leans more, in rad, the gripper leans, too
_SLIGHT: Final = math.radians(1)  # if an object leans more, in rad, and no upright grasp is free, the gripper leans
_RIMS: Final = ("rim on the arm's side", "rim in front", "rim on the other side")

GraspSide: TypeAlias = Literal["front", "top", "left", "right"]  # the side from which a gripper comes
GRASPS: Final[Mapping[str, Quaternion]] = {
    "front": (0.0, 0.0, 0.0, 1.0),
    "top": geometry.from_rpy(0.0, math.pi / 2, 0.0),
    "left": geometry.from_rpy(0.0, 0.0, -math.pi / 2),  # from the robot's left to its right
    "right": geometry.from_rpy(0.0, 0.0, math.pi / 2),
}
"""Orientations of the tool in a frame with the robot's heading."""


@dataclass(frozen=True, slots=True)
class Grasp:
    """A pose of the tool for grasping an object."""

    name: str  # the side from which the gripper comes
    position: Vector  # position of the tool frame in the world, m
    orientation: Quaternion  # orientation of the tool frame in the world, xyzw
    width: float  # distance in m between the fingers when they hold the object
    label: str = ""  # a unique name among the candidates, such as "top across"; "" for the name of the side

    def __str__(self) -> str:
        return self.label or self.name


def candidates(
    body: Object,
    robot: Object,
    arm: Arm,
    names: Sequence[str] | None = None,
    *,
    off_center: bool = False,
    base: Pose | None = None,
    choice: Choice = UNRECORDED,
) -> Sequence[Grasp]:
    """Return grasps of an object, best first; the robot's heading defines the front.

    ``names`` are the allowed sides; None for all sides. With ``off_center``, the result has other grasps: from the top
    beside the middle of a long object, and with the lean of a slightly leaning object.
    """
    offsets: Sequence[Vector] = ((0.0, 0.0, 0.0),)
    sides = names
    if off_center:
        offsets = _along_length(body) if names is None or "top" in names else ()
        names = ("top",)
    facing = heading(robot, base)
    lying = body.get_orientation()
    lean = leaning(lying)
    stood = geometry.product(geometry.conjugate(lean), lying)
    angle = geometry.angle(lean, IDENTITY[1])
    found: list[Grasp] = []
    leant = [(names, shift) for shift in _shifts(offsets, stood)] if angle >= _LEANING else []
    if off_center and _SLIGHT < angle < _LEANING:
        leant = [(sides, (0.0, 0.0, 0.0))]
    if leant:
        caster = RayCaster(body, lean)
        for some, shift in leant:
            for grasp in _upright(caster, stood, robot, arm, facing, some, shift, choice):
                away = [a - b for a, b in zip(grasp.position, caster.center, strict=True)]
                x, y, z = (a + b for a, b in zip(geometry.rotate(lean, away), caster.center, strict=True))
                turn = geometry.product(lean, grasp.orientation)
                found.append(replace(grasp, position=(x, y, z), orientation=turn, label=f"{grasp} leaning"))
    shifts = _shifts(offsets, lying)
    if shifts:
        caster = RayCaster(body)
        for shift in shifts:
            found.extend(_upright(caster, lying, robot, arm, facing, names, shift, choice))
    labels = distinct(grasp.label for grasp in found)
    return [replace(grasp, label=label) for grasp, label in zip(found, labels, strict=True)]


def _shifts(offsets: Sequence[Vector], lying: Quaternion | Sequence[float]) -> list[Vector]:
    """Return shifts in m along a lying object of a grasp from the top; an upright object has no shifts."""
    turned = (geometry.rotate(lying, offset) for offset in offsets)
    return [
        (x, y, 0.0)
        for offset, (x, y, _) in zip(offsets, turned, strict=True)
        if not any(offset) or math.hypot(x, y) >= _BESIDE
    ]


def _along_length(body: Object) -> Sequence[Vector]:
    """Return offsets in m, in a long object's frame, from its middle towards its ends."""
    solids = solids_of(body.model.path)
    size = solids.high.max(axis=0) - solids.low.min(axis=0)
    longest = int(size.argmax())
    if len(body.links) > 1 or size[longest] < _LONG * np.sort(size)[1]:
        return ()
    axis = np.eye(3)[longest] * size[longest] / 4
    (x, y, z), (u, v, w) = axis.tolist(), (-axis).tolist()
    return (x, y, z), (u, v, w)


def leaning(lying: Sequence[float]) -> Quaternion:
    """Return the rotation from the vertical to the nearest axis of an object with an orientation."""
    axes = [geometry.rotate(lying, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    x, y, z = max(axes, key=lambda axis: abs(axis[2]))
    if z < 0.0:
        x, y, z = -x, -y, -z
    half = math.acos(min(1.0, z)) / 2
    across = math.hypot(x, y)
    if across == 0.0:
        return IDENTITY[1]
    return -y / across * math.sin(half), x / across * math.sin(half), 0.0, math.cos(half)


def _upright(
    caster: RayCaster,
    lying: Quaternion | Sequence[float],
    robot: Object,
    arm: Arm,
    facing: Quaternion,
    names: Sequence[str] | None,
    shift: Vector,
    choice: Choice,
) -> list[Grasp]:
    """Return grasps of an object that is treated as upright; ``shift`` in m moves all grasps."""
    beside = " off center" if any(shift) else ""
    dx, dy, _ = shift
    x, y, z = caster.center
    middle = (x + dx, y + dy, z)
    sides: list[list[tuple[str, Quaternion]]] = []
    labels: list[str] = []
    for name, roll in (("front", 0.0), ("top", 0.0), ("top", math.pi / 2), ("left", 0.0), ("right", 0.0)):
        if names is None or name in names:
            turn = geometry.product(geometry.product(facing, GRASPS[name]), geometry.from_rpy(roll, 0.0, 0.0))
            sides.append([(name, other) for other in (turn, *along(turn, lying))])
            labels.append(f"{name}{' across' if roll else ''}{beside}")
    every = [option for options in sides for option in options]
    fitting: Iterator[Grasp | Misfit | Uneven]
    if arm.gripper.suction:
        fitting = _on_surface(caster, every, arm)
    else:
        fitting = iter(_between_fingers(caster, every, arm, middle, arm.bias(robot.urdf)))
    found: list[Grasp] = []
    for label, options in zip(labels, sides, strict=True):
        (_, turn), *_ = options
        tried = list(itertools.islice(fitting, len(options)))
        fit = [grasp for grasp in tried if isinstance(grasp, Grasp)]
        if fit:  # the robot's heading is preferred, unless the object lies across
            widths = [grasp.width + (grasp.orientation != turn) * FREE for grasp in fit]
            found.append(replace(fit[widths.index(min(widths))], label=label))
        else:
            misfits = (each for each in tried if not isinstance(each, Grasp))
            choice.reject(label, min(misfits, key=lambda each: each.miss()))
    rims = arm.gripper.fingers and middle == caster.center and (names is None or "top" in names)
    if rims and all(grasp.name != "top" for grasp in found):
        found.extend(_rims(caster, robot, arm, facing, choice))
    return found


def along(turn: Quaternion, lying: Sequence[float]) -> Iterator[Quaternion]:
    """Yield an orientation, turned about the vertical, in which the fingers close along an axis of the object."""
    x, y, _ = geometry.rotate(turn, (0.0, 1.0, 0.0))
    for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        along = geometry.rotate(lying, axis)
        if abs(along[2]) > _UPRIGHT:
            continue
        skew = math.atan2(along[1], along[0]) - math.atan2(y, x)
        skew = (skew + math.pi / 4) % (math.pi / 2) - math.pi / 4  # fingers close along either side of a rectangle
        if abs(skew) > _SKEW:
            yield geometry.product(geometry.from_rpy(0.0, 0.0, skew), turn)
        return


def _between_fingers(
    caster: RayCaster, options: Sequence[tuple[str, Quaternion]], arm: Arm, middle: Vector, bias: float
) -> Iterator[Grasp | Misfit]:
    """Yield a grasp for each option, with the object centered between the fingers, or why the object doesn't fit."""
    if not options:
        return
    gripper = arm.gripper
    scans, counts, floors = [], [], []
    for name, turn in options:
        x, y, z = middle
        if name != "top":
            z = max(z, caster.low[2] + gripper.underside)
        half = half_extent(caster.low, caster.high, geometry.rotate(turn, (1.0, 0.0, 0.0)))
        counts.append(max(4, math.ceil((half + gripper.tips) / _STEP)))
        step = (min(half, gripper.tips) + half) / counts[-1]
        scans.append(Scan(((x, y, z), turn), step / 2 - half, step))
        floors.append(z - caster.low[2] - gripper.tips - _CLEARANCE if name == "top" else math.inf)
    surfaces = caster.extents(scans, counts, _PADS)
    lows, highs = surfaces[:, :, 0], surfaces[:, :, 1]
    number = np.arange(max(counts))
    points = np.array([[scan.first] for scan in scans]) + number * np.array([[scan.step] for scan in scans])
    solid = ~np.isnan(lows) & (number < np.array(counts)[:, None])
    depths = np.minimum(np.minimum(np.where(solid, points, np.inf).min(axis=1) + gripper.depth, 0.0), floors)
    held = solid & (points <= depths[:, None] + gripper.tips)
    lows = np.where(held, lows, np.inf).min(axis=1)
    highs = np.where(held, highs, -np.inf).max(axis=1)
    widths = highs - lows
    least, most = gripper.gap, gripper.aperture - FREE
    solids = held.any(axis=1)
    columns = (solids & (widths <= most) & (widths >= least), solids, depths, lows, highs)
    found = zip(options, scans, *(column.tolist() for column in columns), strict=True)
    for (name, turn), scan, fit, solid_there, deep, low, high in found:
        if fit:
            across = (low + high) / 2 - gripper.middle(high - low, bias)
            yield Grasp(name, geometry.transform(scan.frame, (deep, across, 0.0)), turn, high - low)
        else:
            yield Misfit(high - low if solid_there else None, least, most)


def _on_surface(caster: RayCaster, options: Sequence[tuple[str, Quaternion]], arm: Arm) -> Iterator[Grasp | Uneven]:
    """Yield a grasp of a suction cup on a flat place for each option, or why there is no flat place."""
    gripper = arm.gripper
    radius = gripper.suction
    for name, turn in options:
        x, y, z = caster.center
        if name != "top":
            z = max(z, caster.low[2] + gripper.underside)
        # the y axis of the frame points into the object
        frame = (x, y, z), geometry.product(turn, geometry.from_rpy(0.0, 0.0, -math.pi / 2))
        scan = Scan(frame, -radius, radius)
        points = [caster.extents([scan], 3, (across,))[0, :, 0] for across in (-radius, 0.0, radius)]
        uneven = float(np.ptp(points))
        on_surface = geometry.transform(frame, (0.0, float(points[1][1]), 0.0))
        if uneven <= _FLAT:  # outside of the object, ``uneven`` is nan
            yield Grasp(name, on_surface, turn, 0.0)
        else:
            yield Uneven(None if math.isnan(uneven) else uneven)


def _rims(caster: RayCaster, robot: Object, arm: Arm, facing: Quaternion, choice: Choice) -> Iterator[Grasp]:
    """Yield grasps over the wall of a wide hollow object: on the side of the arm, in front, and at the back."""
    gripper, bias = arm.gripper, arm.bias(robot.urdf)
    side = 1.0 if robot.urdf.forward_kinematics({}, robot.urdf.joint(arm.joints[0]).child)[0][1] >= 0 else -1.0
    x, y, _ = caster.center
    top, bottom = caster.high[2], caster.low[2]
    height = max(top - gripper.depth, bottom + gripper.tips + _CLEARANCE)
    first = top - _EDGE
    step = (max(height - gripper.tips, bottom + _CLEARANCE) - first) / (_LEVELS - 1)
    frames = []
    for direction in ((0.0, side, 0.0), (-1.0, 0.0, 0.0), (0.0, -side, 0.0)):
        away = geometry.rotate(facing, direction)
        frames.append(((x, y, 0.0), geometry.from_rpy(0.0, 0.0, math.atan2(away[1], away[0]))))
    walls = caster.walls([Scan(frame, first, step) for frame in frames], _LEVELS, _PADS)
    for label, frame, roll, wall in zip(_RIMS, frames, (0.0, math.pi / 2, 0.0), walls, strict=True):
        floors = np.flatnonzero(np.isnan(wall).any(axis=1)).tolist()
        floor = floors[0] if floors else _LEVELS
        if not floor:
            choice.reject(label, Misfit(None, gripper.gap, gripper.aperture - FREE))
            continue
        tips = height
        if floor < _LEVELS:  # the finger tips stay above the bottom of the hollow
            tips = max(tips, first + floor * step + gripper.tips + _CLEARANCE)
        inside, outside = float(wall[:floor, 0].min()), float(wall[:floor, 1].max())
        if not gripper.gap <= outside - inside <= gripper.aperture - FREE:
            choice.reject(label, Misfit(outside - inside, gripper.gap, gripper.aperture - FREE))
            continue
        turn = geometry.product(geometry.product(facing, GRASPS["top"]), geometry.from_rpy(roll, 0.0, 0.0))
        width = outside - inside
        grasp_x, grasp_y, _ = geometry.transform(frame, ((inside + outside) / 2, 0.0, 0.0))
        between = (grasp_x, grasp_y, tips), turn
        yield Grasp("top", geometry.transform(between, (0.0, -gripper.middle(width, bias), 0.0)), turn, width, label)


def grasp_orientation(grasp: str, robot: Object, base: Pose | None = None) -> Quaternion:
    """Return the orientation of the tool in the world for a grasp; raise UnknownName for an unknown grasp."""
    if checks.text("grasp", grasp) not in GRASPS:
        raise UnknownName("grasp", grasp, "a gripper", GRASPS)
    return geometry.product(heading(robot, base), GRASPS[grasp])


def heading(robot: Object, base: Pose | None = None) -> Quaternion:
    """Return a robot's orientation about the vertical, at its present pose or with its base at another pose."""
    return geometry.from_rpy(0.0, 0.0, yaw(robot) if base is None else geometry.yaw_of(base[1]))


def yaw(body: Object) -> float:
    """Return the angle in rad of an object's x axis about the vertical."""
    return geometry.yaw_of(body.get_orientation())
