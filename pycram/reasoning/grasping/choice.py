"""Which grasp is taken, and with which posture of the arm: the one that touches least (thesis 4.4.6)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import Blocked, DoesNotFit, GraspFailed, PlanFailure, Unreachable
from pycram.reasoning.choosing import UNRECORDED, Choice
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping import fingers
from pycram.reasoning.grasping.grasps import FREE, Grasp, candidates, leaning
from pycram.reasoning.kinematics.inverse import Solver
from pycram.reasoning.rejections import Misfit, OutOfReach, Slips, Touching, Untried
from recorder import geometry
from recorder.geometry import IDENTITY

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from pycram.foundation.failures import CollisionPair
    from pycram.models.robots.description import Arm
    from pycram.physics.body import ClosestPoint
    from pycram.reasoning.collision.checker import Collision, Pair
    from pycram.reasoning.grasping.fingers import Closing
    from pycram.reasoning.kinematics.inverse import Posture
    from pycram.world.object import Object
    from recorder.geometry import Pose

    Touch = tuple[Pair, list[ClosestPoint]]
    Cost = tuple[bool, float, float, float]


_FREE: Final = (False, 0, 0, 0.0)  # what a posture costs that touches nothing
_INFINITE: Final = (True, math.inf, math.inf, math.inf)  # more than any posture costs
_HAND: Final = -1  # stands for the hand alone, before all postures for the same grasp
_MAX_GRASPS: Final = 6  # that are tried, one after the other
_LEANING: Final = math.radians(5)  # that the message tells


@dataclass(frozen=True, slots=True)
class GraspPlan:
    """A grasp with the posture for it."""

    grasp: Grasp | None  # the grasp, None if nothing reaches
    posture: Posture | None  # of the arm; the nearest miss if nothing reaches
    # what the arm would touch there, deepest first, and how
    obstacles: Mapping[Object, Collision] = field(default_factory=dict)
    # pairs of the robot's own links that would touch, if that is why nothing reaches
    self_collisions: Sequence[CollisionPair] = ()
    penetrating: CollisionPair | None = None  # links of the open hand, and of the target, that would overlap there

    def evidence(self) -> dict[str, object]:
        """Return it as records carry it."""
        fields: dict[str, object] = {"reached": self.grasp is not None}
        if self.grasp is not None:
            fields |= {"grasp": self.grasp.name, "position": self.grasp.position, "orientation": self.grasp.orientation}
        if self.posture is not None:
            fields |= self.posture.evidence()
        if self.self_collisions:
            fields["touches_itself"] = [[pair.link, pair.body_link] for pair in self.self_collisions]
        return fields | {"obstacles": {body.name: info for body, info in self.obstacles.items()}}


def best(
    body: Object,
    robot: Object,
    link: str,
    names: Sequence[str] | None = None,
    refused: Collection[Grasp] = (),
    choice: Choice = UNRECORDED,
    base: Pose | None = None,
) -> GraspPlan:
    """Return the grasp that touches least: in the middle of the object; beside it if it is long and only that is free.

    Args:
        link: an arm's tool frame, or any other link, which then just has to get to the target's center.
        names: the sides that are allowed; all by default.
        refused: grasps that are left out.
        choice: gets why the others aren't taken.
        base: pose that the robot's base is taken to have; where it stands by default.
    """
    arm = robot.description.arm_of(link) if robot.description else None
    takes = arm if arm is not None and arm.hand is not None else None
    grasping = _Grasping(body, robot, Solver(robot, link), takes, choice, base)
    if takes is None:  # it takes nothing, and gets to places as any link does
        return grasping.best_of([Grasp("any", center(body), IDENTITY[1], 0.0)])
    central = candidates(body, robot, takes, names, base=base, choice=choice)
    plan = grasping.best_of([grasp for grasp in central if grasp not in refused])
    if plan.grasp is None or plan.obstacles:
        every = candidates(body, robot, takes, names, off_center=True, base=base, choice=choice)
        free = grasping.best_of([grasp for grasp in every if grasp not in refused], limit=_FREE)
        if free.grasp is not None:
            return free
    return plan


@dataclass(frozen=True, slots=True)
class _Grasping:
    """Who takes what."""

    body: Object  # the target
    robot: Object  # the robot
    solver: Solver  # of the arm's inverse kinematics
    arm: Arm | None  # the arm, None if it takes nothing
    choice: Choice  # gets why grasps aren't taken
    base: Pose | None  # pose that the robot's base is taken to have; None where it stands

    def best_of(self, grasps: Sequence[Grasp], limit: Cost = _INFINITE) -> GraspPlan:
        """Return the one of some grasps that touches least, and costs no more than ``limit``."""
        if not grasps:
            return GraspPlan(None, None)
        solver = self.solver
        if self.arm is None:
            return self._least_touching(
                grasps, solver.search([(grasp.position, None, self.base) for grasp in grasps]), limit
            )
        targets = [(grasp.position, grasp.orientation, self.base) for grasp in grasps]
        # a long search finds what is at the edge of what the arm can: only if there is need
        solved = solver.closed_form(targets) if solver.in_closed_form else solver.search(targets, quick=True)
        if any(posture.reaches() for postures in solved for posture in postures):
            quick = not solver.in_closed_form
            plan = self._least_touching(grasps, solved, limit, quick=quick)
            if not quick or (plan.grasp is not None and not plan.obstacles and plan.penetrating is None):
                return plan
        return self._least_touching(grasps, solver.search(targets, thorough=True), limit)

    def _least_touching(
        self, grasps: Sequence[Grasp], solved: Sequence[Sequence[Posture]], limit: Cost, *, quick: bool = False
    ) -> GraspPlan:
        """Return the grasp that touches least of those that postures were found for; a quick miss proves nothing."""
        options = []
        for grasp, postures in zip(grasps, solved, strict=True):
            reaching = [posture for posture in postures if posture.reaches()]
            if reaching:
                options.append((grasp, reaching))
            elif quick:
                self.choice.reject(str(grasp), Untried())
            else:  # the closed form doesn't say by how much
                nearest = postures[0] if postures else None
                miss = (nearest.position_error, nearest.turn_error) if nearest else (None, 0.0)
                self.choice.reject(str(grasp), OutOfReach(*miss))
        if not options:
            missed = itertools.chain.from_iterable(solved)
            return GraspPlan(None, min(missed, key=lambda posture: posture.position_error, default=None))
        joints = self.solver.joints
        opened = self.arm.gripper.positions("open") if self.arm else {}
        with CollisionChecker(self.robot, [*joints, *opened], [] if self.arm else [self.body]) as checker:
            hand = checker.links_beyond(joints)
            return _Choice(self.body, checker, options, opened, hand, self.choice, self.base).best(limit)


class _Choice:
    """The choice of the posture that touches least, of several the first: a best-first search.

    It goes on with the posture that costs least by what is known of it, and checks the next pair of links there,
    until that one is known completely: no other can cost less then. The hand is where it is whatever the arm does, so
    it is checked once for each grasp, and its cost is a lower bound for all postures for that grasp.

    Args:
        target: the object, which the open hand shouldn't be in.
        options: grasps, each with the postures for it.
        opened: joint values of the open gripper.
        hand: links that all postures for a grasp bring to one pose.
        choice: gets what is known of the grasps in the end.
        base: pose that the robot's base is taken to have; None where it stands.
    """

    def __init__(
        self,
        target: Object,
        checker: CollisionChecker,
        options: Sequence[tuple[Grasp, Sequence[Posture]]],
        opened: Mapping[str, float],
        hand: Collection[str],
        choice: Choice,
        base: Pose | None,
    ) -> None:
        self._target = target
        self._choice = choice
        self._checker = checker
        self._options = options
        every = [{**posture.positions, **opened} for _, postures in options for posture in postures]
        candidates = iter(checker.predict(every, base))  # all at once: it takes little longer than one
        self._candidates = [list(itertools.islice(candidates, len(postures))) for _, postures in options]
        self._hand = hand
        self._arm = checker.moving - set(hand)

    def best(self, limit: Cost) -> GraspPlan:
        """Return the grasp, its posture, and what is touched there; none of those that cost more than ``limit``."""
        plan = self._least(limit)
        if self._choice.wanted:
            self._record(plan)
        return plan

    def _record(self, plan: GraspPlan) -> None:
        """Record what is known of the grasps: of the best all, of the others what was checked until they were worse."""
        for (grasp, postures), tried in zip(self._options, self._candidates, strict=True):
            known = [self._checker.known(candidate) for candidate in tried]
            by_hand = [pair for pair in known[0] if pair.link in self._hand]
            if grasp is plan.grasp:
                pairs = [collision["pair"] for collision in plan.obstacles.values()]
                pairs += [plan.penetrating] if plan.penetrating else []
            else:  # one posture of which nothing is known may do
                pairs = by_hand or min(known, key=len)
            self._choice.reject(str(grasp), Touching(pairs) if pairs else Untried(), len(postures))

    def _least(self, limit: Cost) -> GraspPlan:
        """Return the plan that touches least."""
        queue: list[tuple[Cost, int, int, dict[Object, float], Iterator[Touch]]] = []
        for option, (first, *_) in enumerate(self._candidates):
            heappush(queue, (_FREE, option, _HAND, {}, self._checker.collisions(first, self._hand)))
        contorted: dict[tuple[int, int], GraspPlan] = {}  # postures in which the robot touches itself
        while queue:
            cost, option, number, depths, touches = heappop(queue)
            bound = queue[0][:3] if queue else (_INFINITE, 0, 0)
            cost = self._check(touches, depths, cost, min(bound[0], limit))
            grasp, postures = self._options[option]
            if cost > limit:
                continue
            if (cost, option, number) > bound:
                heappush(queue, (cost, option, number, depths, touches))
            elif number == _HAND:
                for each, candidate in enumerate(self._candidates[option]):
                    rest = self._checker.collisions(candidate, self._arm)
                    heappush(queue, (cost, option, each, dict(depths), rest))
            elif pairs := self._checker.self_collisions(self._candidates[option][number]):
                contorted[option, number] = GraspPlan(None, postures[number], self_collisions=pairs)
            else:
                obstacles = self._checker.touched(self._candidates[option][number])
                within = obstacles.pop(self._target, None)
                return GraspPlan(grasp, postures[number], obstacles, penetrating=within["pair"] if within else None)
        return contorted[max(contorted)] if contorted else GraspPlan(None, None)

    def _check(self, touches: Iterator[Touch], depths: dict[Object, float], cost: Cost, enough: Cost) -> Cost:
        """Check what a posture touches, and return what that costs.

        Args:
            touches: what is found by and by; it goes on where it was left.
            depths: of what is touched, m; what is found is added.
            cost: of what is touched so far.
            enough: as soon as it costs more, the rest doesn't matter yet.
        """
        for (_, _, body, _), points in touches:
            depth = max(-point.distance for point in points)
            if depth > depths.get(body, 0.0):
                depths[body] = depth
                cost = self._cost(depths)
                if cost > enough:
                    break
        return cost

    def _cost(self, depths: Mapping[Object, float]) -> Cost:
        """Furniture stays, other things can be moved first, little overlap is better."""
        counted = {body: depth for body, depth in depths.items() if body is not self._target}
        furniture = sum(body.fixed for body in counted)
        return self._target in depths, furniture, len(counted) - furniture, sum(sorted(counted.values()))


def ways_to_hold(
    robot: Object,
    arm: Arm,
    body: Object,
    names: Sequence[str] | None,
    failures: list[PlanFailure],
    choice: Choice,
    base: Pose | None = None,
) -> Iterator[tuple[Grasp, Posture, Closing]]:
    """Yield grasps with the arm's posture and how the gripper closes then, the one that touches least first.

    Args:
        robot: the robot; its world's lock is held.
        names: the sides that are allowed; None for all.
        failures: gets why others won't do; the caller may add its own, and it ends after a few of either.
        choice: gets the same, by grasp.
        base: pose that the robot's base is taken to have; where it stands by default.
    """
    refused: list[Grasp] = []
    while len(failures) < _MAX_GRASPS:
        plan = best(body, robot, arm.tool_frame, names, refused, choice, base)
        if plan.grasp is None or plan.posture is None:
            failures.append(_nothing(robot, arm, body, names, plan, base))
            return
        closing = fingers.closed_around(robot, arm, plan.posture.positions, body, base)
        failure = _problem(arm, body, plan, closing)
        if failure is not None:
            failures.append(failure)
            slips = Slips(closing.sides if closing else 0)
            choice.reject(str(plan.grasp), Touching(failure.pairs) if isinstance(failure, Blocked) else slips)
        elif closing is not None:
            yield plan.grasp, plan.posture, closing
        refused.append(plan.grasp)


def _nothing(
    robot: Object, arm: Arm, body: Object, names: Sequence[str] | None, plan: GraspPlan, base: Pose | None
) -> PlanFailure:
    """Return why no grasp was found."""
    if plan.posture is None:
        tilt = geometry.angle(leaning(body), geometry.IDENTITY[1])
        lies = f"as it leans, by {math.degrees(tilt):.0f} degrees, " if tilt > _LEANING else ""
        if arm.gripper.suction:
            return GraspFailed(arm.name, body.name, f"{lies}it is nowhere flat enough for the suction cup")
        sides = Choice("grasp", {})  # also where nobody records
        candidates(body, robot, arm, names, base=base, choice=sides)
        misfits = [reason for reason in sides.reasons() if isinstance(reason, Misfit)]
        widths = [misfit.width for misfit in misfits if misfit.width is not None]
        return DoesNotFit(arm.name, body.name, widths, arm.gripper.gap, arm.gripper.aperture - FREE, lies)
    if plan.self_collisions:
        return Blocked(arm.name, center(body), plan.self_collisions)
    return Unreachable(arm.name, center(body), plan.posture.position_error)


def _problem(arm: Arm, body: Object, plan: GraspPlan, closing: Closing | None) -> PlanFailure | None:
    """Return why a grasp doesn't do; None if it does."""
    if plan.obstacles:
        return Blocked(arm.name, center(body), [collision["pair"] for collision in plan.obstacles.values()])
    if plan.penetrating is not None:
        return Blocked(arm.name, center(body), [plan.penetrating])
    if closing is None:
        return GraspFailed(arm.name, body.name, "its fingers would close on nothing")
    if closing.obstacles:
        return Blocked(arm.name, center(body), closing.obstacles, "when the fingers close")
    if closing.sides < 2:
        return GraspFailed(arm.name, body.name, "its fingers would touch it on one side only")
    return None
