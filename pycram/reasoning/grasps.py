"""How a parallel gripper can take an object: from which side, where, and with which posture of the arm.

Candidates come from the object's bounds: from the front, the top, the left and the right where it fits between the
fingers, else over its rim from the top. The tool frame stands between the finger tips; its distance to palm and tips
says how deep it can go in. Of the candidates that the arm reaches, the one that touches least is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from pycram.reasoning import reach
from pycram.reasoning.rehearsal import Rehearsal
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.engine import Quaternion, Vector
    from pycram.objects import Object
    from pycram.reasoning.reach import Reach
    from pycram.robots.description import Arm

_PALM: Final = 0.018  # m from the tool frame back to the palm, less a little
_TIPS: Final = 0.045  # m from the tool frame to the finger tips, and a little more
_FLAT: Final = 0.042  # m from the tool frame to the gripper's underside when it lies level
_RIM: Final = 0.004  # m from the outside of a rim to the middle of its wall
_SPARE: Final = 0.004  # m of the aperture that has to stay free


@dataclass(frozen=True, slots=True)
class Grasp:
    """A way to take an object.

    Attributes:
        name: the side that the gripper comes from.
        position: of the tool frame in the world, m.
        orientation: of the tool frame in the world, xyzw.
        width: m between the fingers when they hold it.
    """

    name: str
    position: Vector
    orientation: Quaternion
    width: float


@dataclass(frozen=True, slots=True)
class GraspPlan:
    """A grasp with the posture for it.

    Attributes:
        grasp: the grasp, None if nothing reaches.
        reach: the posture; the nearest miss if nothing reaches.
        obstacles: what the arm would touch there, deepest first, and how.
    """

    grasp: Grasp | None
    reach: Reach | None
    obstacles: Mapping[Object, Mapping[str, object]] = field(default_factory=dict)

    def evidence(self) -> dict[str, object]:
        """As records carry it."""
        told: dict[str, object] = {"reached": self.grasp is not None}
        if self.grasp is not None:
            told |= {"grasp": self.grasp.name, "position": self.grasp.position, "orientation": self.grasp.orientation}
        if self.reach is not None:
            told |= self.reach.evidence()
        return told | {"obstacles": {body.name: info for body, info in self.obstacles.items()}}


def middle(body: Object) -> Vector:
    """The middle of an object's bounds, m."""
    (x0, y0, z0), (x1, y1, z1) = body.get_AABB()
    return (x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2


def candidates(body: Object, robot: Object, arm: Arm, names: Sequence[str] | None = None) -> Iterator[Grasp]:
    """Ways to take an object, best first.

    Args:
        body: the object.
        robot: the robot; its heading says what is front.
        arm: the arm whose gripper is to take it.
        names: the sides that are allowed; all by default.
    """
    low, high = body.get_AABB()
    center = middle(body)
    bottom = low[2]
    for name, roll in (("front", 0.0), ("top", 0.0), ("top", math.pi / 2), ("left", 0.0), ("right", 0.0)):
        if names is not None and name not in names:
            continue
        turn = geometry.product(reach.approach(name, robot), geometry.from_rpy(roll, 0.0, 0.0))
        width = _extent(turn, (0.0, 1.0, 0.0), low, high)
        if width > arm.gripper.aperture - _SPARE:
            continue
        back = _extent(turn, (1.0, 0.0, 0.0), low, high) / 2 - _PALM
        if name == "top":
            back = max(back, _TIPS - (center[2] - bottom))
            at = (center[0], center[1], center[2] + back)
        else:
            forward = geometry.rotate(turn, (1.0, 0.0, 0.0))
            x, y, z = (c - max(back, 0.0) * f for c, f in zip(center, forward, strict=True))
            at = (x, y, max(z, bottom + _FLAT))
        yield Grasp(name, at, turn, width)
    if names is None or "top" in names:
        yield from _rims(robot, arm, low, high)


def _rims(robot: Object, arm: Arm, low: Sequence[float], high: Sequence[float]) -> Iterator[Grasp]:
    """Over the wall of something hollow that is too wide: beside the middle on the arm's side, or in front of it."""
    sideways = _extent(reach.approach("front", robot), (0.0, 1.0, 0.0), low, high)
    if sideways <= arm.gripper.aperture - _SPARE:
        return
    top = max(high[2] - _PALM, low[2] + _TIPS)
    middle_xy = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)
    straight = reach.approach("front", robot)
    shoulder = robot.urdf.forward_kinematics({}, robot.urdf.joint(arm.joints[0]).child)[0]
    side = 1.0 if shoulder[1] >= 0 else -1.0
    for direction, roll in (((0.0, side, 0.0), 0.0), ((-1.0, 0.0, 0.0), math.pi / 2), ((0.0, -side, 0.0), 0.0)):
        dx, dy, _ = geometry.rotate(straight, direction)
        half = _extent(straight, direction, low, high) / 2 - _RIM
        turn = geometry.product(reach.approach("top", robot), geometry.from_rpy(roll, 0.0, 0.0))
        yield Grasp("top", (middle_xy[0] + dx * half, middle_xy[1] + dy * half, top), turn, 2 * _RIM)


def _extent(turn: Sequence[float], axis: Vector, low: Sequence[float], high: Sequence[float]) -> float:
    """Size of a box along an axis of a turned frame."""
    direction = geometry.rotate(turn, axis)
    return sum(abs(part) * (b - a) for part, a, b in zip(direction, low, high, strict=True))


def best(body: Object, robot: Object, link: str, names: Sequence[str] | None = None) -> GraspPlan:
    """The grasp that touches least.

    Args:
        body: the object.
        robot: the robot, as it stands.
        link: an arm's tool frame, or any other link, which then just has to get to the object's middle.
        names: the sides that are allowed; all by default.
    """
    arm = robot.description.arm_of(link) if robot.description else None
    if arm is None:
        options: list[Grasp | None] = [None]
    else:
        options = list(candidates(body, robot, arm, names))
    nearest: Reach | None = None
    least: GraspPlan | None = None
    opened = arm.gripper.positions("open") if arm else {}
    _, joints = reach.moving_joints(robot, link)
    with Rehearsal(robot, [*joints, *opened], [body]) as rehearsal:
        for grasp in options:
            place = grasp or Grasp("any", middle(body), (0.0, 0.0, 0.0, 1.0), 0.0)
            for option in reach.postures(robot, link, place.position, grasp.orientation if grasp else None):
                if not option.reached(reach.THRESHOLD):
                    if nearest is None or option.posture.position_error < nearest.posture.position_error:
                        nearest = option
                    continue
                rehearsal.take({**option.posture.positions, **opened})
                if rehearsal.touches_itself():
                    continue
                plan = GraspPlan(place, option, rehearsal.touched())
                if not plan.obstacles:
                    return plan
                if least is None or _cost(plan) < _cost(least):
                    least = plan
    return least or GraspPlan(None, nearest)


def _cost(plan: GraspPlan) -> tuple[int, int, float]:
    """Furniture stays in the way, other things can be moved first; of the same, little overlap is better."""
    furniture = sum(other.fixed for other in plan.obstacles)
    depth = sum(float(str(info["depth"])) for info in plan.obstacles.values())
    return furniture, len(plan.obstacles) - furniture, depth
