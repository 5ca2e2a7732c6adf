"""How a parallel gripper can take an object: from which side, where, and with which posture of the arm.

Candidates come from the object's outline: from the front, the top, the left and the right where it fits between the
fingers, else over its rim from the top. The gripper is turned with an object that lies across, and takes it in the
middle between its fingers. Of the candidates that the arm reaches, the one that touches least is taken.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning import reach
from pycram.reasoning.outline import Outline, Scan, middle
from pycram.reasoning.reach import Solver
from pycram.reasoning.rehearsal import Rehearsal
from recorder import geometry
from recorder.geometry import IDENTITY

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from pycram.objects import Object
    from pycram.reasoning.reach import Reach
    from pycram.reasoning.rehearsal import Foreseen
    from pycram.robots.description import Arm
    from recorder.geometry import Quaternion, Vector

    Cost = tuple[bool, float, float, float]
    Rank = tuple[Cost, int, int]

_SPARE: Final = 0.004  # m of the aperture that has to stay free
_CLEAR: Final = 0.002  # m that the finger tips keep from what the object stands on
_PADS: Final = (-0.01, 0.0, 0.01)  # m across the finger pads, where an object's surface is looked for
_STEP: Final = 0.004  # m between such places along the fingers
_LEVELS: Final = 6  # at which the wall below a rim is looked for
_EDGE: Final = 0.004  # m below a rim where its wall begins
_UPRIGHT: Final = 0.7  # of a unit axis along the vertical: an axis that stands
_FREE: Final = (False, 0, 0, 0.0)  # what a posture costs that touches nothing
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


def candidates(body: Object, robot: Object, arm: Arm, names: Sequence[str] | None = None) -> Sequence[Grasp]:
    """Ways to take an object, best first.

    Args:
        body: the object.
        robot: the robot; its heading says what is front.
        arm: the arm whose gripper is to take it.
        names: the sides that are allowed; all by default.
    """
    outline = Outline(body)
    heading, lying = reach.heading(robot), body.get_orientation()
    asked: list[list[tuple[str, Quaternion]]] = []
    for name, roll in (("front", 0.0), ("top", 0.0), ("top", math.pi / 2), ("left", 0.0), ("right", 0.0)):
        if names is None or name in names:
            turn = geometry.product(geometry.product(heading, reach.GRASPS[name]), geometry.from_rpy(roll, 0.0, 0.0))
            asked.append([(name, other) for other in (turn, *_along(turn, lying))])
    fitting = iter(_between_fingers(outline, [way for ways in asked for way in ways], arm))
    found: list[Grasp] = []
    for ways in asked:
        (_, turn), *_ = ways
        fit = [grasp for grasp in itertools.islice(fitting, len(ways)) if grasp is not None]
        if fit:  # as the robot stands, unless the object lies across
            widths = [grasp.width + (grasp.orientation != turn) * _SPARE for grasp in fit]
            found.append(fit[widths.index(min(widths))])
    if all(grasp.name != "top" for grasp in found) and (names is None or "top" in names):
        found.extend(_rims(outline, robot, arm))
    return found


def _along(turn: Quaternion, lying: Sequence[float]) -> Iterator[Quaternion]:
    """The same orientation turned about the vertical so that the fingers close along one of the object's axes."""
    x, y, _ = geometry.rotate(turn, (0.0, 1.0, 0.0))
    for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        along = geometry.rotate(lying, axis)
        if abs(along[2]) > _UPRIGHT:
            continue
        skew = math.atan2(along[1], along[0]) - math.atan2(y, x)
        skew = (skew + math.pi / 4) % (math.pi / 2) - math.pi / 4  # the object's faces look alike to fingers
        if abs(skew) > _SKEW:
            yield geometry.product(geometry.from_rpy(0.0, 0.0, skew), turn)
        return


def _between_fingers(outline: Outline, ways: Sequence[tuple[str, Quaternion]], arm: Arm) -> Iterator[Grasp | None]:
    """For each side and orientation the grasp with the object in the middle between the fingers; None if too wide."""
    if not ways:
        return
    gripper = arm.gripper
    scans, counts = [], []
    for name, turn in ways:
        x, y, z = outline.middle
        if name != "top":
            z = max(z, outline.low[2] + gripper.underside)
        half = outline.half(geometry.rotate(turn, (1.0, 0.0, 0.0)))
        counts.append(max(4, math.ceil((half + gripper.tips) / _STEP)))
        step = (min(half, gripper.tips) + half) / counts[-1]
        scans.append(Scan(((x, y, z), turn), step / 2 - half, step))
    surfaces = outline.across(scans, max(counts), _PADS).tolist()
    for (name, turn), scan, count, surface in zip(ways, scans, counts, surfaces, strict=True):
        solid = [
            (scan.first + number * scan.step, low, high)
            for number, (low, high) in enumerate(surface[:count])
            if not math.isnan(low)
        ]
        if not solid:
            yield None
            continue
        deep = min(solid[0][0] + gripper.depth, 0.0)
        if name == "top":
            deep = min(deep, scan.frame[0][2] - outline.low[2] - gripper.tips - _CLEAR)
        held = [(low, high) for place, low, high in solid if place <= deep + gripper.tips]
        low = min((low for low, _ in held), default=-math.inf)
        high = max((high for _, high in held), default=math.inf)
        if high - low > gripper.aperture - _SPARE:
            yield None
        else:
            at = geometry.transform(scan.frame, (deep, (low + high) / 2, 0.0))
            yield Grasp(name, at, turn, high - low)


def _rims(outline: Outline, robot: Object, arm: Arm) -> Iterator[Grasp]:
    """Over the wall of something hollow that is too wide: beside the middle on the arm's side, or in front of it."""
    gripper = arm.gripper
    shoulder = robot.urdf.forward_kinematics({}, robot.urdf.joint(arm.joints[0]).child)[0]
    side = 1.0 if shoulder[1] >= 0 else -1.0
    x, y, _ = outline.middle
    top, bottom = outline.high[2], outline.low[2]
    height = max(top - gripper.depth, bottom + gripper.tips + _CLEAR)
    first = top - _EDGE
    step = (max(height - gripper.tips, bottom + _CLEAR) - first) / (_LEVELS - 1)
    heading = reach.heading(robot)
    frames = []
    for direction in ((0.0, side, 0.0), (-1.0, 0.0, 0.0), (0.0, -side, 0.0)):
        away = geometry.rotate(heading, direction)
        frames.append(((x, y, 0.0), geometry.from_rpy(0.0, 0.0, math.atan2(away[1], away[0]))))
    walls = outline.walls([Scan(frame, first, step) for frame in frames], _LEVELS, _PADS)
    for frame, roll, wall in zip(frames, (0.0, math.pi / 2, 0.0), walls, strict=True):
        floors = np.flatnonzero(np.isnan(wall).any(axis=1)).tolist()
        floor = floors[0] if floors else _LEVELS
        if not floor:
            continue
        tips = height
        if floor < _LEVELS:  # tips stay above the floor of the hollow
            tips = max(tips, first + floor * step + gripper.tips + _CLEAR)
        inside, outside = float(wall[:floor, 0].min()), float(wall[:floor, 1].max())
        if outside - inside > gripper.aperture - _SPARE:
            continue
        turn = geometry.product(geometry.product(heading, reach.GRASPS["top"]), geometry.from_rpy(roll, 0.0, 0.0))
        middle_x, middle_y, _ = geometry.transform(frame, ((inside + outside) / 2, 0.0, 0.0))
        yield Grasp("top", (middle_x, middle_y, tips), turn, outside - inside)


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
        found = [(Grasp("any", at, IDENTITY[1], 0.0), solver.postures(at, None))]
    else:
        grasps = candidates(body, robot, arm, names)
        targets = [(grasp.position, grasp.orientation, None) for grasp in grasps]
        ways = solver.at_once(targets)
        if not any(ways):  # what has to be searched for is at the edge of what the arm can: for need only
            ways = solver.searched(targets)
        found = list(zip(grasps, ways, strict=True))
    reaching = [(grasp, [way for way in ways if way.reached(reach.THRESHOLD)]) for grasp, ways in found]
    reaching = [(grasp, ways) for grasp, ways in reaching if ways]
    if not reaching:
        missed = (way for _, ways in found for way in ways)
        return GraspPlan(None, min(missed, key=lambda way: way.posture.position_error, default=None))
    opened = arm.gripper.positions("open") if arm else {}
    with Rehearsal(robot, [*solver.joints, *opened], [] if arm else [body]) as rehearsal:
        return _Choice(body, rehearsal, reaching, opened, rehearsal.beyond(solver.joints)).made()


class _Choice:
    """The choice of the posture that touches least; of several the first.

    The hand is where it is whatever the arm does, so it is looked at once for each grasp: if it alone is worse than
    what was found already, no posture for that grasp will do. Grasps that are good for the hand come first.

    Args:
        body: the object, which the open hand shouldn't be in.
        rehearsal: of the robot.
        options: grasps, each with the postures for it.
        opened: joint values of the open gripper.
        hand: links that all postures for a grasp bring to one place.
    """

    def __init__(
        self,
        body: Object,
        rehearsal: Rehearsal,
        options: Sequence[tuple[Grasp, Sequence[Reach]]],
        opened: Mapping[str, float],
        hand: Collection[str],
    ) -> None:
        self._body = body
        self._rehearsal = rehearsal
        self._options = options
        every = [{**way.posture.positions, **opened} for _, ways in options for way in ways]
        foreseen = iter(rehearsal.foresee(every))  # all at once: it takes little longer than one
        self._foreseen = [list(itertools.islice(foreseen, len(ways))) for _, ways in options]
        self._hand = hand
        self._arm = rehearsal.moving() - set(hand)
        self._least: Rank = ((True, math.inf, math.inf, math.inf), 0, 0)
        self._chosen: tuple[Foreseen, GraspPlan] | None = None
        self._bent: tuple[Rank, GraspPlan] | None = None

    def made(self) -> GraspPlan:
        """The grasp, its posture, and what is touched there."""
        waiting: list[tuple[Cost, int, dict[Object, float]]] = []
        for number, postures in enumerate(self._foreseen):
            self._rehearsal.take(postures[0])
            depths: dict[Object, float] = {}
            cost = self._cost(depths, self._hand, (self._least[0], number, 0))
            if cost <= _FREE:
                self._look(number, depths)
            elif (cost, number, 0) < self._least:
                heappush(waiting, (cost, number, depths))
            if self._least[0] <= _FREE:
                waiting.clear()
                break
        while waiting:
            cost, number, depths = heappop(waiting)
            if (cost, number, 0) < self._least:
                self._look(number, depths)
        if self._chosen is None:
            return self._bent[1] if self._bent else GraspPlan(None, None)
        posture, plan = self._chosen
        self._rehearsal.take(posture)
        obstacles = self._rehearsal.touched()
        obstacles.pop(self._body, None)
        return replace(plan, obstacles=obstacles)

    def _look(self, number: int, hand: Mapping[Object, float]) -> None:
        """Looks at all postures for one grasp, of which it is known what the hand touches, and how deep, m."""
        grasp, ways = self._options[number]
        bound = self._told(hand)
        for place, (way, posture) in enumerate(zip(ways, self._foreseen[number], strict=True)):
            self._rehearsal.take(posture)
            rank = (self._cost(dict(hand), self._arm, self._least), number, place)
            if rank >= self._least:
                continue
            own = self._rehearsal.touches_itself()
            if not own:
                self._least, self._chosen = rank, (posture, GraspPlan(grasp, way))
            elif self._bent is None or rank[1:] > self._bent[0][1:]:
                self._bent = rank, GraspPlan(None, way, own=own)
            if self._least[0] <= bound:
                return

    def _cost(self, depths: dict[Object, float], links: Collection[str], enough: Rank) -> Cost:
        """What a posture costs: furniture stays, other things can be moved first, little overlap is better.

        Args:
            depths: of what is touched, m; what these links touch is added.
            links: the robot's links that are looked at.
            enough: as soon as it is as bad, the rest doesn't matter.

        Returns:
            Whether something is in the object, numbers of fixed objects and of others, the sum of the depths in m.
        """
        cost = self._told(depths)
        for other, touch in self._rehearsal.hits(links):
            if -touch.distance > depths.get(other, 0.0):
                depths[other] = -touch.distance
                cost = self._told(depths)
                if cost > enough[0]:
                    break
        return cost

    def _told(self, depths: Mapping[Object, float]) -> Cost:
        counted = [hit for hit in depths if hit is not self._body]
        furniture = sum(hit.fixed for hit in counted)
        deep = sum(sorted(depths[hit] for hit in counted))
        return self._body in depths, furniture, len(counted) - furniture, deep
