"""How a parallel gripper can take an object: from which side, where, and with which posture of the arm.

Candidates come from the object's outline: from the front, the top, the left and the right where it fits between the
fingers, else over its rim from the top. The gripper is turned with an object that lies across, and takes it in the
middle between its fingers. Of the candidates that the arm reaches, the one that touches least is taken.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning import reach
from pycram.reasoning.outline import Outline, middle
from pycram.reasoning.reach import Solver
from pycram.reasoning.rehearsal import Rehearsal
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from pycram.objects import Object
    from pycram.reasoning.reach import Reach
    from pycram.robots.description import Arm
    from recorder.geometry import Quaternion, Vector

_SPARE: Final = 0.004  # m of the aperture that has to stay free
_CLEAR: Final = 0.002  # m that the finger tips keep from what the object stands on
_PADS: Final = (-0.01, 0.0, 0.01)  # m across the finger pads, where an object's surface is looked for
_STEP: Final = 0.004  # m between such places along the fingers
_EDGE: Final = 0.004  # m below a rim where its wall begins
_UPRIGHT: Final = 0.7  # of a unit axis along the vertical: an axis that stands
_SKEW: Final = math.radians(2)  # that an object may be turned from the gripper as if it weren't


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
        own: pairs of the robot's own links that would touch, if that is why nothing reaches.
    """

    grasp: Grasp | None
    reach: Reach | None
    obstacles: Mapping[Object, Mapping[str, object]] = field(default_factory=dict)
    own: Sequence[tuple[str, str]] = ()

    def cost(self, links: Collection[str] | None = None) -> tuple[int, int, float]:
        """How much is in the way: furniture stays, other things can be moved first; little overlap is better.

        Args:
            links: the robot's links that count; all by default.

        Returns:
            Number of fixed objects, of others, and the sum of the depths in m.
        """
        hits = [
            (other.fixed, float(str(info["depth"])))
            for other, info in self.obstacles.items()
            if links is None or _by(info, links)
        ]
        furniture = sum(fixed for fixed, _ in hits)
        return furniture, len(hits) - furniture, sum(depth for _, depth in hits)

    def evidence(self) -> dict[str, object]:
        """As records carry it."""
        told: dict[str, object] = {"reached": self.grasp is not None}
        if self.grasp is not None:
            told |= {"grasp": self.grasp.name, "position": self.grasp.position, "orientation": self.grasp.orientation}
        if self.reach is not None:
            told |= self.reach.evidence()
        if self.own:
            told["touches_itself"] = [list(pair) for pair in self.own]
        return told | {"obstacles": {body.name: info for body, info in self.obstacles.items()}}


def _by(hit: Mapping[str, object] | None, links: Collection[str]) -> bool:
    """Whether some of the robot's links touch what is hit."""
    names = hit["links"] if hit else []
    return isinstance(names, list) and any(name in links for name in names)


def candidates(body: Object, robot: Object, arm: Arm, names: Sequence[str] | None = None) -> Iterator[Grasp]:
    """Ways to take an object, best first.

    Args:
        body: the object.
        robot: the robot; its heading says what is front.
        arm: the arm whose gripper is to take it.
        names: the sides that are allowed; all by default.
    """
    outline = Outline(body)
    fits_from_top = False
    for name, roll in (("front", 0.0), ("top", 0.0), ("top", math.pi / 2), ("left", 0.0), ("right", 0.0)):
        if names is not None and name not in names:
            continue
        turn = geometry.product(reach.approach(name, robot), geometry.from_rpy(roll, 0.0, 0.0))
        options = [_between_fingers(outline, name, other, arm) for other in (turn, *_along(turn, body))]
        fitting = [grasp for grasp in options if grasp is not None]
        if fitting:  # as the robot stands, unless the object lies across
            fits_from_top |= name == "top"
            yield min(fitting, key=lambda grasp: grasp.width + (grasp.orientation != turn) * _SPARE)
    if not fits_from_top and (names is None or "top" in names):
        yield from _rims(outline, robot, arm)


def _along(turn: Quaternion, body: Object) -> Iterator[Quaternion]:
    """The same orientation turned about the vertical so that the fingers close along one of the object's axes."""
    x, y, _ = geometry.rotate(turn, (0.0, 1.0, 0.0))
    heading = body.get_orientation()
    for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        along = geometry.rotate(heading, axis)
        if abs(along[2]) > _UPRIGHT:
            continue
        skew = math.atan2(along[1], along[0]) - math.atan2(y, x)
        skew = (skew + math.pi / 4) % (math.pi / 2) - math.pi / 4  # the object's faces look alike to fingers
        if abs(skew) > _SKEW:
            yield geometry.product(geometry.from_rpy(0.0, 0.0, skew), turn)
        return


def _between_fingers(outline: Outline, name: str, turn: Quaternion, arm: Arm) -> Grasp | None:
    """The grasp from one side, with the object in the middle between the fingers; None if it doesn't fit."""
    gripper = arm.gripper
    x, y, z = outline.middle
    if name != "top":
        z = max(z, outline.low[2] + gripper.underside)
    half = outline.half(geometry.rotate(turn, (1.0, 0.0, 0.0)))
    count = max(4, math.ceil((half + gripper.tips) / _STEP))
    places = np.linspace(-half, min(half, gripper.tips), 2 * count + 1)[1::2]
    surface = outline.across(((x, y, z), turn), places.tolist(), _PADS)
    solid = ~np.isnan(surface[:, 0])
    if not solid.any():
        return None
    deep = min(float(places[solid][0]) + gripper.depth, 0.0)
    if name == "top":
        deep = min(deep, z - outline.low[2] - gripper.tips - _CLEAR)
    held = surface[solid & (places <= deep + gripper.tips)]
    if not len(held):
        return None
    low, high = float(held[:, 0].min()), float(held[:, 1].max())
    if high - low > gripper.aperture - _SPARE:
        return None
    return Grasp(name, geometry.transform(((x, y, z), turn), (deep, (low + high) / 2, 0.0)), turn, high - low)


def _rims(outline: Outline, robot: Object, arm: Arm) -> Iterator[Grasp]:
    """Over the wall of something hollow that is too wide: beside the middle on the arm's side, or in front of it."""
    gripper = arm.gripper
    shoulder = robot.urdf.forward_kinematics({}, robot.urdf.joint(arm.joints[0]).child)[0]
    side = 1.0 if shoulder[1] >= 0 else -1.0
    x, y, _ = outline.middle
    top, bottom = outline.high[2], outline.low[2]
    for direction, roll in (((0.0, side, 0.0), 0.0), ((-1.0, 0.0, 0.0), math.pi / 2), ((0.0, -side, 0.0), 0.0)):
        away = geometry.rotate(reach.approach("front", robot), direction)
        frame = ((x, y, 0.0), geometry.from_rpy(0.0, 0.0, math.atan2(away[1], away[0])))
        height = max(top - gripper.depth, bottom + gripper.tips + _CLEAR)
        levels = np.linspace(top - _EDGE, max(height - gripper.tips, bottom + _CLEAR), 6)
        wall = outline.wall(frame, _PADS, levels.tolist())
        solid = [bool(np.isnan(level).any()) for level in wall]
        if solid[0]:
            continue
        if any(solid):  # the floor of the hollow: tips stay above it
            floor = solid.index(True)
            height = max(height, float(levels[floor]) + gripper.tips + _CLEAR)
            wall = wall[:floor]
        inside, outside = float(wall[:, 0].min()), float(wall[:, 1].max())
        if outside - inside > gripper.aperture - _SPARE:
            continue
        turn = geometry.product(reach.approach("top", robot), geometry.from_rpy(roll, 0.0, 0.0))
        middle_x, middle_y, _ = geometry.transform(frame, ((inside + outside) / 2, 0.0, 0.0))
        yield Grasp("top", (middle_x, middle_y, height), turn, outside - inside)


def best(body: Object, robot: Object, link: str, names: Sequence[str] | None = None) -> GraspPlan:
    """The grasp that touches least.

    Args:
        body: the object.
        robot: the robot, as it stands.
        link: an arm's tool frame, or any other link, which then just has to get to the object's middle.
        names: the sides that are allowed; all by default.
    """
    arm = robot.description.arm_of(link) if robot.description else None
    solver = Solver(robot, link)
    if arm is None:
        at = middle(body)
        found = iter([(Grasp("any", at, (0.0, 0.0, 0.0, 1.0), 0.0), solver.postures(at, None))])
        opened, hand = {}, {link}
    else:
        found = _reaches(candidates(body, robot, arm, names), solver)
        opened, hand = arm.gripper.positions("open"), {arm.gripper.palm, *arm.gripper.fingers}
    nearest: Reach | None = None
    least: GraspPlan | None = None
    bent: GraspPlan | None = None
    rank: tuple[float, ...] = (math.inf,)
    with Rehearsal(robot, [*solver.joints, *opened], [] if arm else [body]) as rehearsal:
        for grasp, ways in found:
            for way in ways:
                if not way.reached(reach.THRESHOLD):
                    if nearest is None or way.posture.position_error < nearest.posture.position_error:
                        nearest = way
                    continue
                rehearsal.take({**way.posture.positions, **opened})
                touched = rehearsal.touched()
                pushed = touched.pop(body, None)  # the open hand would be in the object itself
                plan = GraspPlan(grasp, way, touched)
                mine = (pushed is not None, *plan.cost())
                if mine < rank:
                    own = rehearsal.touches_itself()
                    if own:
                        bent = GraspPlan(None, way, own=own)
                    else:
                        least, rank = plan, mine
                if rank <= (False, 0, 0, 0.0):
                    return plan
                # the hand is where it is whatever the arm does: no other posture can be better than what it hits
                if rank[:3] <= (_by(pushed, hand), *plan.cost(hand)[:2]):
                    break
    return least or bent or GraspPlan(None, nearest)


def _reaches(options: Iterator[Grasp], solver: Solver) -> Iterator[tuple[Grasp, list[Reach]]]:
    """Postures for grasps. Those that have to be searched for are at the edge of what the arm can: for need only."""
    missed: list[Grasp] = []
    reached = False
    for group in _first_and_rest(options):
        poses = [(grasp.position, grasp.orientation, None) for grasp in group]
        for grasp, ways in zip(group, solver.at_once(poses), strict=True):
            if ways:
                reached = True
                yield grasp, ways
            else:
                missed.append(grasp)
    if not reached:
        for grasp in missed:
            yield grasp, solver.postures(grasp.position, grasp.orientation)


def _first_and_rest(options: Iterator[Grasp]) -> Iterator[list[Grasp]]:
    """The best one alone, as mostly it will do, and the others at once."""
    yield list(itertools.islice(options, 1))
    yield list(options)
