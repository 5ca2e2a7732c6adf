"""Which grasp is taken, and with which posture of the arm: the one that touches least (thesis 4.4.6)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Final

from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.collision.ray_cast import middle
from pycram.reasoning.grasping.grasps import Grasp, candidates
from pycram.reasoning.kinematics import reach
from pycram.reasoning.kinematics.reach import Solver
from recorder.geometry import IDENTITY

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from pycram.reasoning.kinematics.reach import Reach
    from pycram.world.object import Object

    Cost = tuple[bool, float, float, float]

_FREE: Final = (False, 0, 0, 0.0)  # what a posture costs that touches nothing
_NEVER: Final = (True, math.inf, math.inf, math.inf)  # more than any posture costs
_HAND: Final = -1  # the place of the hand alone, before all postures for the same grasp


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
    with CollisionChecker(robot, [*solver.joints, *opened], [] if arm else [body]) as rehearsal:
        return _Choice(body, rehearsal, reaching, opened, rehearsal.beyond(solver.joints)).made()


class _Choice:
    """The choice of the posture that touches least; of several the first.

    It goes on with the one that costs least by what is known of it, and looks at the next pair of links there, until
    that one is known completely: no other can cost less then. The hand is where it is whatever the arm does, so it is
    looked at once for each grasp, and what it costs is what all postures for that grasp cost at least.

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
        rehearsal: CollisionChecker,
        options: Sequence[tuple[Grasp, Sequence[Reach]]],
        opened: Mapping[str, float],
        hand: Collection[str],
    ) -> None:
        self._body = body
        self._rehearsal = rehearsal
        self._options = options
        every = [{**way.posture.positions, **opened} for _, ways in options for way in ways]
        candidates = iter(rehearsal.predict(every))  # all at once: it takes little longer than one
        self._candidates = [list(itertools.islice(candidates, len(ways))) for _, ways in options]
        self._hand = hand
        self._arm = rehearsal.moving() - set(hand)

    def made(self) -> GraspPlan:
        """The grasp, its posture, and what is touched there."""
        waiting: list[tuple[Cost, int, int, dict[Object, float]]] = []
        waiting.extend((_FREE, number, _HAND, {}) for number in range(len(self._options)))
        bent: tuple[int, int, GraspPlan] = -1, 0, GraspPlan(None, None)
        while waiting:
            cost, number, place, depths = heappop(waiting)
            least = waiting[0][:3] if waiting else (_NEVER, 0, 0)
            if (cost, number, place) <= least:
                self._rehearsal.take(self._candidates[number][max(place, 0)])
                cost = self._cost(depths, self._hand if place == _HAND else self._arm, least[0])
            if (cost, number, place) > least:
                heappush(waiting, (cost, number, place, depths))
                continue
            grasp, ways = self._options[number]
            if place == _HAND:
                for each in range(len(ways)):
                    heappush(waiting, (cost, number, each, dict(depths)))
            elif own := self._rehearsal.touches_itself():
                bent = max(bent, (number, place, GraspPlan(None, ways[place], own=own)), key=lambda found: found[:2])
            else:
                obstacles = self._rehearsal.touched()
                obstacles.pop(self._body, None)
                return GraspPlan(grasp, ways[place], obstacles)
        return bent[2]

    def _cost(self, depths: dict[Object, float], links: Collection[str], enough: Cost) -> Cost:
        """What a posture costs: furniture stays, other things can be moved first, little overlap is better.

        Args:
            depths: of what is touched, m; what these links touch is added.
            links: the robot's links that are looked at.
            enough: as soon as it is worse, the rest doesn't matter yet.

        Returns:
            Whether something is in the object, numbers of fixed objects and of others, the sum of the depths in m.
        """
        cost = self._told(depths)
        for other, touches in self._rehearsal.hits(links):
            deepest = max(-touch.distance for touch in touches)
            if deepest > depths.get(other, 0.0):
                depths[other] = deepest
                cost = self._told(depths)
                if cost > enough:
                    break
        return cost

    def _told(self, depths: Mapping[Object, float]) -> Cost:
        counted = {hit: depth for hit, depth in depths.items() if hit is not self._body}
        furniture = sum([hit.fixed for hit in counted])
        return self._body in depths, furniture, len(counted) - furniture, sum(sorted(counted.values()))
