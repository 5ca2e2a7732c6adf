"""The choice of a grasp and of a posture for this grasp: the pair with the least contact (thesis 4.4.6)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import Blocked, CollisionPair, DoesNotFit, GraspFailed, PlanFailure, Unreachable
from pycram.physics.body import ClosestPoint
from pycram.reasoning.choosing import UNRECORDED, Choice
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping import fingers
from pycram.reasoning.grasping.fingers import Closing
from pycram.reasoning.grasping.grasps import FREE, Grasp, along, candidates, leaning
from pycram.reasoning.kinematics.inverse import Posture, Solver
from pycram.reasoning.rejections import Misfit, OutOfReach, Slips, Touching, Untried
from recorder import geometry
from recorder.geometry import IDENTITY, Pose

if TYPE_CHECKING:
    from pycram.models.robots.description import Arm
    from pycram.reasoning.collision.checker import Collision, Pair
    from pycram.world.object import Object

    Touch = tuple[Pair, list[ClosestPoint]]
    Cost = tuple[bool, float, float, float]

_FREE: Final = (False, 0, 0, 0.0)  # cost of a posture that touches nothing
_INFINITE: Final = (True, math.inf, math.inf, math.inf)  # a higher cost than that of any posture
_HAND: Final = -1  # replaces the posture's index while only the hand is checked
_MAX_GRASPS: Final = 6  # maximum number of grasps that are tried
_DEEPER: Final = (0.004, 0.008)  # distances in m by which a grasp is moved towards the object
_LEANING: Final = math.radians(5)  # lean of an object in rad from which messages mention the lean


@dataclass(frozen=True, slots=True)
class GraspPlan:
    """A grasp, and a posture of the arm for this grasp."""

    grasp: Grasp | None  # None if the arm reaches no grasp
    posture: Posture | None  # the nearest posture if the arm reaches no grasp
    # collisions of the arm in the posture, ordered by object; the deepest collision is first
    obstacles: Mapping[Object, Collision] = field(default_factory=dict)
    self_collisions: Sequence[CollisionPair] = ()  # the robot's own links that would touch, if all grasps fail on them
    penetrating: CollisionPair | None = None  # links of the open hand and of the target that would overlap

    def evidence(self) -> dict[str, object]:
        """Return the plan as evidence for a record."""
        fields: dict[str, object] = {"reached": self.grasp is not None}
        if self.grasp is not None:
            fields |= {"grasp": self.grasp.name, "position": self.grasp.position, "orientation": self.grasp.orientation}
        if self.posture is not None:
            fields |= self.posture.evidence()
        if self.self_collisions:
            fields["touches_itself"] = [[pair.link, pair.body_link] for pair in self.self_collisions]
        return fields | {"obstacles": {body.name: info for body, info in self.obstacles.items()}}


def best_grasp(
    body: Object,
    robot: Object,
    link: str,
    names: Sequence[str] | None = None,
    refused: Collection[Grasp] = (),
    choice: Choice = UNRECORDED,
    base: Pose | None = None,
    adjusted: Collection[Grasp] = (),
) -> GraspPlan:
    """Return the grasp with the least contact. A grasp off the center is chosen only if no other grasp is free.

    A ``link`` without a gripper only has to reach the target's center. ``names`` are the allowed sides; None for all.
    """
    arm = robot.description.arm_of(link) if robot.description else None
    takes = arm if arm is not None and arm.hand is not None else None
    grasping = _Grasping(body, robot, Solver(robot, link), takes, choice, base)
    if takes is None:  # a link without a gripper only has to reach the target's center
        return grasping.best_of([Grasp("any", center(body), IDENTITY[1], 0.0)])
    central = [*candidates(body, robot, takes, names, base=base, choice=choice), *adjusted]
    plan = grasping.best_of([grasp for grasp in central if grasp not in refused and choice.admits(str(grasp))])
    if plan.grasp is None or plan.obstacles:
        every = candidates(body, robot, takes, names, off_center=True, base=base, choice=choice)
        every = [grasp for grasp in every if grasp not in refused and choice.admits(str(grasp))]
        free = grasping.best_of(every, limit=_FREE)
        if free.grasp is not None:
            return free
    return plan


@dataclass(frozen=True, slots=True)
class _Grasping:
    body: Object  # the target
    robot: Object
    solver: Solver  # solver of the arm's inverse kinematics
    arm: Arm | None  # None if the link has no gripper
    choice: Choice  # receives the reasons against grasps
    base: Pose | None  # assumed pose of the robot's base; None for its present pose

    def best_of(self, grasps: Sequence[Grasp], limit: Cost = _INFINITE) -> GraspPlan:
        if not grasps:
            return GraspPlan(None, None)
        solver = self.solver
        targets = [(grasp.position, grasp.orientation if self.arm else None, self.base) for grasp in grasps]
        if self.arm is None:
            return self._least_touching(grasps, solver.search(targets), limit)
        # the thorough search finds postures at the limit of the arm's reach, but runs only if the quick search fails
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
        """Return the grasp with the least contact, from known postures; a ``quick`` search may miss this grasp."""
        options = []
        for grasp, postures in zip(grasps, solved, strict=True):
            reaching = [posture for posture in postures if posture.reaches()]
            if reaching:
                options.append((grasp, reaching))
            elif quick:
                self.choice.reject(str(grasp), Untried())
            else:  # the closed form returns no distance to the target
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
    """A best-first search for the posture that touches least.

    The search takes the posture with the least known cost, and checks its next pair of links. The search ends when the
    cheapest posture is checked completely, because no other posture can cost less. All postures for a grasp have the
    same pose of the hand, so the hand is checked only once, and its cost is a lower bound for these postures.
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
        candidates = iter(checker.predict(every, base))  # takes hardly longer than for a single posture
        self._candidates = [list(itertools.islice(candidates, len(postures))) for _, postures in options]
        self._hand = hand
        self._arm = checker.moving - set(hand)

    def best(self, limit: Cost) -> GraspPlan:
        plan = self._least(limit)
        if self._choice.wanted:
            self._record(plan)
        return plan

    def _record(self, plan: GraspPlan) -> None:
        """Record all collisions of the best grasp; other grasps were checked only until their costs were higher."""
        for (grasp, postures), tried in zip(self._options, self._candidates, strict=True):
            known = [self._checker.known(candidate) for candidate in tried]
            by_hand = [pair for pair in known[0] if pair.link in self._hand]
            if grasp is plan.grasp:
                pairs = [collision["pair"] for collision in plan.obstacles.values()]
                pairs += [plan.penetrating] if plan.penetrating else []
            else:  # a posture that wasn't checked completely may be free
                pairs = by_hand or min(known, key=len)
            self._choice.reject(str(grasp), Touching(pairs) if pairs else Untried(), len(postures))

    def _least(self, limit: Cost) -> GraspPlan:
        queue: list[tuple[Cost, int, int, dict[Object, float], Iterator[Touch]]] = []
        for option, (first, *_) in enumerate(self._candidates):
            heappush(queue, (_FREE, option, _HAND, {}, self._checker.collisions(first, self._hand)))
        contorted: dict[tuple[int, int], GraspPlan] = {}  # plans in which the robot's own links collide
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
                    heappush(queue, (cost, option, each, dict(depths), self._checker.collisions(candidate, self._arm)))
            elif pairs := self._checker.self_collisions(self._candidates[option][number]):
                contorted[option, number] = GraspPlan(None, postures[number], self_collisions=pairs)
            else:
                obstacles = self._checker.touched(self._candidates[option][number])
                within = obstacles.pop(self._target, None)
                return GraspPlan(grasp, postures[number], obstacles, penetrating=within["pair"] if within else None)
        return contorted[max(contorted)] if contorted else GraspPlan(None, None)

    def _check(self, touches: Iterator[Touch], depths: dict[Object, float], cost: Cost, enough: Cost) -> Cost:
        """Check the next contacts of a posture until its cost exceeds ``enough``, and return the cost.

        ``depths`` has the depths in m of earlier contacts by object; this method adds new depths.
        """
        for (_, _, body, _), points in touches:
            depth = max(-point.distance for point in points)
            if depth > depths.get(body, 0.0):
                depths[body] = depth
                counted = {other: deep for other, deep in depths.items() if other is not self._target}
                furniture = sum(other.fixed for other in counted)  # furniture counts more, because it can't be moved
                cost = self._target in depths, furniture, len(counted) - furniture, sum(sorted(counted.values()))
                if cost > enough:
                    break
        return cost


def holding_grasps(
    robot: Object,
    arm: Arm,
    body: Object,
    names: Sequence[str] | None,
    failures: list[PlanFailure],
    choice: Choice,
    base: Pose | None = None,
) -> Iterator[tuple[Grasp, Posture, Closing]]:
    """Yield grasps with a posture of the arm and the closed gripper; the grasp with the least contact comes first.

    ``names`` are the allowed sides; None for all sides. ``failures`` receives the reasons against other grasps. The
    caller may add failures, too; after a few failures the search ends.
    """
    refused: list[Grasp] = []
    adjusted: list[Grasp] = []
    while len(failures) < _MAX_GRASPS + len(adjusted):
        plan = best_grasp(body, robot, arm.tool_frame, names, refused, choice, base, adjusted)
        if plan.grasp is None or plan.posture is None:
            failures.append(_nothing(robot, arm, body, names, plan, base))
            return
        closing = fingers.close_around(robot, arm, plan.posture.positions, body, base)
        failure = _problem(arm, body, plan, closing)
        if failure is not None:
            failures.append(failure)
            slips = Slips(closing.sides if closing else 0)
            choice.reject(str(plan.grasp), Touching(failure.pairs) if isinstance(failure, Blocked) else slips)
        elif closing is not None:
            yield plan.grasp, plan.posture, closing
        refused.append(plan.grasp)
        if closing is not None and plan.grasp not in adjusted:
            adjusted.extend(_adjusted(body, plan.grasp, closing))


def _adjusted(body: Object, grasp: Grasp, closing: Closing) -> Iterator[Grasp]:
    """Yield grasps near a grasp that doesn't hold a thin object.

    If the fingers would touch furniture, one grasp is higher. If the fingers would touch fewer than two sides of the
    object, other grasps are deeper, because open fingers may reach less far; some of these turn with the object.
    """
    if closing.obstacles and all(body.world.get_object(pair.body).fixed for pair in closing.obstacles):
        x, y, z = grasp.position
        rise = max(pair.depth for pair in closing.obstacles) + fingers.CLEAR
        yield replace(grasp, position=(x, y, z + rise), label=f"{grasp}, higher")
    elif not closing.obstacles and closing.sides < 2:
        turned = [replace(grasp, orientation=turn) for turn in along(grasp.orientation, body.get_orientation())]
        for each, deeper in itertools.product((grasp, *turned), _DEEPER):
            position = geometry.transform((each.position, each.orientation), (deeper, 0.0, 0.0))
            name = f"{grasp}, {'turned, ' if each is not grasp else ''}{1e3 * deeper:.0f} mm deeper"
            yield replace(each, position=position, label=name)


def _nothing(
    robot: Object, arm: Arm, body: Object, names: Sequence[str] | None, plan: GraspPlan, base: Pose | None
) -> PlanFailure:
    if plan.posture is None:
        tilt = geometry.angle(leaning(body.get_orientation()), geometry.IDENTITY[1])
        lies = f"because it leans by {math.degrees(tilt):.0f} degrees, " if tilt > _LEANING else ""
        others = () if names is None else candidates(body, robot, arm, base=base)
        fitting = " or ".join(dict.fromkeys(f"the {grasp.name}" for grasp in others)) or "no other side"
        elsewhere = "" if names is None else f"; it fits from {fitting}"
        if arm.gripper.suction:
            reason = f"{lies}no part of the object is flat enough for the suction cup{elsewhere}"
            return GraspFailed(arm.name, body.name, reason)
        sides = Choice("grasp", {})  # receives the reasons, even if nothing is recorded
        candidates(body, robot, arm, names, base=base, choice=sides)
        misfits = [reason for reason in sides.reasons() if isinstance(reason, Misfit)]
        widths = [misfit.width for misfit in misfits if misfit.width is not None]
        return DoesNotFit(arm.name, body.name, widths, arm.gripper.gap, arm.gripper.aperture - FREE, lies, elsewhere)
    if plan.self_collisions:
        return Blocked(arm.name, center(body), plan.self_collisions)
    return Unreachable(arm.name, center(body), plan.posture.position_error)


def _problem(arm: Arm, body: Object, plan: GraspPlan, closing: Closing | None) -> PlanFailure | None:
    """Return why a grasp won't hold the object; None if the grasp will hold."""
    pairs = [collision["pair"] for collision in plan.obstacles.values()] or list(filter(None, [plan.penetrating]))
    if pairs:
        return Blocked(arm.name, center(body), pairs)
    if closing is None:
        return GraspFailed(arm.name, body.name, "the fingers would close on nothing")
    if closing.obstacles:
        return Blocked(arm.name, center(body), closing.obstacles, "when the fingers close")
    if closing.sides < 2:
        where = "on one side only" if closing.sides else "on no side"
        return GraspFailed(arm.name, body.name, f"the fingers would touch {body.name} {where}")
    return None
