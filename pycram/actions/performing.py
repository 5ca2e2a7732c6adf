"""Performing actions: choices are tried in order until a choice succeeds or the budget is spent. Each try is a task.

In ``projecting()``, forks of the process try the best choices first (thesis 6.3). If no arm could take an object, the
failure gives advice: turn the object, or slide it to an edge. A copy of the process tests each suggested motion with
reasoning only: no code of the plan runs in the copy, and nothing is recorded.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from pycram.actions.action import TYPES, ActionDesignator, ActionType, prepared, type_of
from pycram.actions.objects import candidates_of, thing
from pycram.foundation import checks
from pycram.foundation.errors import export
from pycram.foundation.failures import (
    BadArgument,
    Blocked,
    DoesNotFit,
    GraspFailed,
    NoPlace,
    PlanFailure,
    PycramError,
    ReasoningError,
    Unreachable,
)
from pycram.foundation.refusals import refusing
from pycram.language.branch import current_block
from pycram.language.retries import FailureHandling
from pycram.models.robots.description import Arm
from pycram.motions.designator import Designator, MotionDesignator, Solution, performing
from pycram.motions.process_module import current_environment
from pycram.motions.slots import DesignatorError
from pycram.process_module import ProcessModule
from pycram.projection import Outcome, is_projected, project_all
from pycram.projection.child import first_true
from pycram.reasoning.choosing import UNRECORDED
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping.choice import holding_grasps
from pycram.reasoning.grasping.grasps import leaning
from pycram.reasoning.grasping.placing import resting_position
from pycram.reasoning.places import standing_places
from pycram.reasoning.places.search import aside, drives
from pycram.scheduling.cancellation import Binding, checkpoint
from pycram.scheduling.future import unwrap
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import Pose
from recorder.records import STEPS_PER_SECOND, Decision, format_error
from recorder.tracing.span import Span

_TURNS: Final = (30, 60, 90, 120, 150)  # tried turns about the vertical, in degrees
_FAR: Final = (90, 30)  # fewer turns in degrees if the robot may drive, because each needs a search for a place
_ON: Final = 0.02  # maximum distance in m between an object's underside and the surface below it
_INSIDE: Final = 0.02  # distance in m between the middle of a slid object and the edge
_EDGES: Final = 4  # number of nearest edges that are tried; half as many if the robot may drive
_SETTLES: Final = STEPS_PER_SECOND // 4  # simulated steps until a moved object is at rest
_MOVED: Final = 0.02  # maximum motion in m of a moved object until it is at rest
_LEANT: Final = math.radians(10)  # maximum turn of a moved object until it is at rest
_SAME: Final = 1e-3  # maximum distance in m between an object and a target that counts as the object's place


def advice(failure: PlanFailure, action: ActionDesignator) -> str:
    """Return advice to move the action's object so that the robot can take the object; "" if no motion helps."""
    slots, failures = dict(action.description), list(_failures(failure))
    robot, given = BulletWorld.current_robot(), candidates_of(thing("object", unwrap(slots["object"])))
    untaken = [body for body in given if failures and all(_untaken(each, body) for each in failures)]
    if robot.description is None or len(untaken) != 1 or untaken[0].fixed or untaken[0].attachments:
        return ""
    body = untaken[0]
    wanted, grasp = (unwrap(slots.get(name)) for name in ("arm", "grasp"))
    arms = [arm for arm in robot.description.arms.values() if wanted in (None, arm.name) and arm.hand is not None]
    free = [arm for arm in arms if attachment.attached_to(robot, arm.tool_frame) is None]
    kind = TYPES.get(action.type)
    chooses = kind is not None and any(slot.name == "place" for slot in kind.slots) and slots.get("place") is None
    moves_base = chooses and drives(robot)
    too_far = all(isinstance(each, Unreachable) and not isinstance(each, Blocked) for each in failures)
    too_big = any(isinstance(each, DoesNotFit) for each in failures)
    turns = [] if too_far or (too_big and grasp is None) else list(_turned(body, _FAR if moves_base else _TURNS))
    slides = [] if too_big else list(_slid(body))[: _EDGES // 2 if moves_base else None]
    found: list[str] = []
    for moves in (turns, slides) if free else ():
        helps = first_true([partial(_helps, robot, body, pose, free, grasp, moves_base) for _, pose in moves])
        found += [moves[helps][0].replace("{}", "it" if found else body.name, 1)] if helps is not None else []
    return f"{' or '.join(found)}, then the robot can take it" if found else ""


def _failures(failure: BaseException) -> Iterator[BaseException]:
    """Yield the failures of all choices that an action and its subactions tried, or else the action's failure."""
    tried = getattr(failure, "tried", ())
    for each in tried:
        if not isinstance(each.failure, ReasoningError):  # skip failures to clear obstacles away
            yield from _failures(each.failure)
    if not tried:
        yield failure


def _untaken(failure: BaseException, body: Object) -> bool:
    """Return whether a failure means that an arm couldn't take an object in its present pose."""
    if isinstance(failure, NoPlace):
        return failure.last == f"reach {body.name}"
    if isinstance(failure, GraspFailed):
        return failure.body == body.name
    return isinstance(failure, Unreachable) and math.dist(failure.target, center(body)) < _SAME


def _turned(body: Object, turns: Sequence[int]) -> Iterator[tuple[str, Pose]]:
    """Yield advice, and poses of an object after turns; in the advice, ``{}`` stands for the object's name."""
    x, y, z = center(body)
    upright = geometry.conjugate(leaning(body.get_orientation()))
    from_middle = geometry.multiply(((-x, -y, -z), geometry.IDENTITY[1]), body.get_position_and_orientation())
    for degrees in turns:
        turn = geometry.product(geometry.from_rpy(0.0, 0.0, math.radians(degrees)), upright)
        yield f"turn {{}} by {degrees} degrees", geometry.multiply(((x, y, z), turn), from_middle)


def _slid(body: Object) -> Iterator[tuple[str, Pose]]:
    """Yield advice, and poses of an object after sliding straight to the nearest edges of its surface."""
    here = body.get_position_and_orientation()
    middle, bottom = body.world.engine.center_of_mass(body.handle)[0], body.get_AABB()[0][2]
    moves = []
    for furniture in body.world.objects:
        for surface in furniture.surfaces.values():
            pose = furniture.surface_pose(surface)
            x, y, _ = geometry.transform(geometry.invert(pose), middle)
            if abs(bottom - pose[0][2]) > _ON or geometry.margin_in_polygon(surface.outline, (x, y)) < 0.0:
                continue
            for a, b in itertools.pairwise([*surface.outline, surface.outline[0]]):
                u, v = (b[1] - a[1]) / math.dist(a, b), (a[0] - b[0]) / math.dist(a, b)  # unit vector, outward
                way = (a[0] - x) * u + (a[1] - y) * v - _INSIDE
                moves.append((way, geometry.rotate(pose[1], (way * u, way * v, 0.0)), surface.name))
    for way, move, name in sorted(moves)[:_EDGES]:
        if way > 0.0:
            there = geometry.multiply((move, geometry.IDENTITY[1]), here)
            x, y = (round(each, 2) + 0.0 for each in there[0][:2])  # no -0.00
            yield f"slide {{}} by {way * 100:.0f} cm to [{x:.2f}, {y:.2f}], at an edge of {name}", there


def _helps(robot: Object, body: Object, pose: Pose, arms: Sequence[Arm], grasp: str | None, moves_base: bool) -> bool:
    """Return whether an object comes to rest at a pose where the robot can take it; moves the object."""
    engine = body.world.engine  # the engine moves the object without a transaction, which would call event handlers
    with body.world.lock:
        there = resting_position(body, *pose), pose[1]
        engine.set_pose(body.handle, there)
        engine.step(_SETTLES)
        position, turn = body.get_position_and_orientation()
        if math.dist(position, there[0]) > _MOVED or geometry.angle(turn, there[1]) > _LEANT:
            return False
    if moves_base:
        names = [arm.name for arm in arms]
        return next(standing_places(robot, reach=[body], arms=names, grasp=grasp, quickly=True), None) is not None
    sides = None if grasp is None else (grasp,)
    with body.world.lock:
        found = (holding_grasps(robot, arm, body, sides, [], UNRECORDED) for arm in arms)
        return any(next(each, None) is not None for each in found)


BUDGET: Final = 20  # default number of failed tries that an action and its subactions may have
_ENDLESS: Final = 10**9  # number of retries; the budget limits the tries
_MAX_REASONS: Final = 4  # maximum number of different failures in the message of ActionFailed
_MAX_IMAGINED: Final = 8  # default number of an action's choices that are projected
#: Number of choices that are projected in parallel: one in the first batch, because the best choice mostly succeeds.
#: The numbers don't depend on the number of cores, so a run has the same records on all computers.
_IN_PARALLEL: Final = (1, 4)


@dataclass(frozen=True, slots=True)
class Thinking:
    """Limits of the projection of choices."""

    budget: int = _MAX_IMAGINED  # maximum number of projected choices of an action
    seconds: float | None = None  # maximum simulated time in s of all choices; None for no limit


_thinking: ContextVar[Thinking | None] = ContextVar("pycram_thinking", default=None)
_ended: ContextVar[bool] = ContextVar("pycram_thought", default=False)


def projecting(budget: int = _MAX_IMAGINED, *, seconds: float | None = None) -> Binding[Thinking | None]:
    """Project the best choices of the actions in the ``with`` block before a choice is performed.

    For example::

        with projecting(budget=4):
            perform(ActionDesignator(type="transporting", object=milk, target="island"))

    Choices are tried in copies of the process, on all cores, and the first successful choice in order is performed. If
    all fail, the action fails, and nothing has moved.

    Args:
        budget: Maximum number of projected choices of an action.
        seconds: Simulated time in s after which no more choices are projected.

    Raises:
        BadArgument: A limit is out of range.
    """
    if isinstance(budget, bool) or not isinstance(budget, int) or budget < 1:
        raise BadArgument("budget", budget, "a whole number of choices, 1 or more")
    if seconds is not None and checks.number("seconds", seconds) <= 0:
        raise BadArgument("seconds", seconds, "a simulated time of more than 0 s")
    return Binding(_thinking, Thinking(budget, seconds))


def not_projecting() -> Binding[bool]:
    """Project no choices in the ``with`` block, even if a slot ``projected`` is True."""
    return Binding(_ended, True)


def thinking(*, wanted: bool | None) -> Thinking | None:
    """Return the limits for projecting an action's choices, or None; ``wanted`` is the slot ``projected``, if given."""
    if _ended.get() or wanted is False:
        return None
    return _thinking.get() or (Thinking() if wanted else None)


def imagine(candidates: Sequence[tuple[ActionType, Solution, Mapping[str, Any]]]) -> list[Outcome]:
    """Perform choices of an action in copies of this process, up to the first success; return the outcomes.

    Each candidate has the action, its solution, and the chosen slots for records; the best candidate comes first. If a
    choice raises an error that isn't a plan failure, this function raises the error.
    """
    outcomes = project_all([partial(_imagined(kind, solution), **choice) for kind, solution, choice in candidates])
    for outcome in outcomes:
        if outcome.failure is not None and not isinstance(outcome.failure, PlanFailure):
            raise outcome.failure
    return outcomes


def _imagined(kind: ActionType, solution: Solution) -> Callable[..., Any]:
    """Return a function for a projection, which performs an action with a solution and has the action's name."""

    def performed(**_: object) -> Any:
        with not_projecting():
            return kind.call(solution)

    performed.__qualname__ = kind.type
    return performed


@dataclass(frozen=True, slots=True)
class Try:
    """A choice that failed."""

    choice: Mapping[str, Any]  # chosen values by slot
    failure: BaseException  # failure of the choice
    imagined: bool = False  # whether the choice was tried only in a projection


class ActionFailed(PlanFailure):
    """All tried choices failed, or the budget was spent."""

    def __init__(
        self,
        action: str,
        tried: Sequence[Try],
        *,
        spent: bool = False,
        shared: int = 0,
        last: BaseException | None = None,
    ) -> None:
        count = f"{len(tried)} {'try' if len(tried) == 1 else 'tries'}"
        ending = "the budget is spent" if spent else "there is nothing else to try"
        if shared:  # the size of a budget that other actions spent as well
            ending = f"other actions spent the rest of the budget of {shared} tries"
        remedy = _remedy(tried)
        super().__init__(f"{action} failed after {count}, {ending}{_summary(tried, last)}{remedy and '; ' + remedy}")
        self.action = action  # type of the action
        self.tried = list(tried)  # the failed choices in order, with their failures
        self.spent = spent  # whether the budget was spent; if so, untried choices may exist
        self.last = last  # failure of the search for further choices; None if the search didn't fail


export("pycram.actions", ActionFailed)


def _summary(tried: Sequence[Try], last: BaseException | None) -> str:
    """Return the failures of tries as text, the most frequent first; equal failures are only counted."""
    groups: dict[str, int] = {}
    for each in tried:
        reason = _reason(each.failure)
        groups[reason] = groups.get(reason, 0) + 1
    commonest = sorted(groups.items(), key=lambda group: -group[1])[:_MAX_REASONS]
    reasons = [f"{count} times: {text}" if count > 1 else text for text, count in commonest]
    reasons += [f"and {len(groups) - _MAX_REASONS} other failures"] if len(groups) > _MAX_REASONS else []
    reasons += [_reason(last)] if last is not None else []
    return ": " + "; ".join(reasons) if reasons else ""


def _remedy(tried: Sequence[Try]) -> str:
    """Return the advice to move aside the objects that blocked all tries; "" without such objects."""
    world = BulletWorld.current_bullet_world
    blocking = [getattr(each.failure, "bodies", None) for each in tried]
    if world is None or not blocking or not all(blocking):
        return ""
    every = [name for name in blocking[0] or () if all(name in (bodies or ()) for bodies in blocking)]
    return aside(every, world.objects)


def _reason(failure: BaseException) -> str:
    """Return a failure as one line; for a failed action, the failure of its first try."""
    while isinstance(failure, ActionFailed) and failure.tried:
        failure = failure.tried[0].failure
    return format_error(failure).partition("\n")[0]


class _Budget:
    """The number of failed tries that an action and its outer actions may still have."""

    def __init__(self, tries: int, around: _Budget | None) -> None:
        self._tries = self._left = tries
        self._around = around

    @property
    def left(self) -> int:
        return self._left if self._around is None else min(self._left, self._around.left)

    @property
    def spent(self) -> int:
        """The size of the innermost spent budget; 0 if no budget is spent."""
        if self._left <= 0:
            return self._tries
        return 0 if self._around is None else self._around.spent

    def spend(self) -> None:
        self._left -= 1
        if self._around is not None:
            self._around.spend()


_budget: ContextVar[_Budget | None] = ContextVar("pycram_budget", default=None)
_takes: ContextVar[bool] = ContextVar("pycram_takes", default=False)  # whether an outer action has the slot object


def perform(designator: ActionDesignator | MotionDesignator) -> Any:
    """Perform an action or a motion; return its result or, in the body of a block with branches, a future.

    Raises:
        DesignatorError: The argument isn't an action or motion, or a slot is missing, unknown or wrong.
        ActionFailed: All choices failed, or the budget is spent.
        PlanFailure: The failure of an action without choices, or of the search for choices.
    """
    if isinstance(designator, MotionDesignator):
        return ProcessModule.perform(designator)
    act = _act(designator)
    block = current_block()
    if block is not None:
        return block.start(act.span.name, act.carry_out, span=act.span)
    with act.span:
        act.span.result = result = act.carry_out()
        return result


@refusing(name="perform")
def _act(designator: Designator) -> _Act:
    if not isinstance(designator, ActionDesignator):
        problem = f"perform takes a designator of an action or a motion, not {designator!r}"
        raise DesignatorError(problem, value=designator)
    BulletWorld.current_robot()
    kinds = [cls for cls in type(designator).__mro__ if issubclass(cls, ActionDesignator)]
    if next(designator.branches(), None) is None and not any(cls.resolvers for cls in kinds):
        designator.check()  # unknown slots are errors, unless the plan has resolvers, which may know these slots
    return _Act(designator)


class _Act:
    def __init__(self, designator: ActionDesignator) -> None:
        slots = {key: value for key, value in designator.description if key != "type"}
        self.span = Span("action", designator.type, parameters=slots)
        self._designator = designator

    def carry_out(self) -> Any:
        """Wait for the futures in the slots, and try the choices."""
        for branch in self._designator.branches():
            branch.result()
        checkpoint()
        slots = dict(self._designator.description)
        outermost = "object" in slots and not (_takes.get() or is_projected())
        with performing(self._designator), Binding(_takes, _takes.get() or outermost):
            try:
                return self._carried_out(slots)
            except PlanFailure as failure:
                with suppress(PycramError):  # the world may be closed
                    if outermost and (helps := advice(failure, self._designator)):
                        failure.args = (f"{failure}; {helps}",)
                raise

    def _carried_out(self, slots: Mapping[str, Any]) -> Any:
        asked, around = slots.get("budget"), _budget.get()
        budget = around if around is not None and asked is None else _Budget(BUDGET if asked is None else asked, around)
        ahead = thinking(wanted=slots.get("projected"))
        with Binding(_budget, budget), prepared(self._designator):
            solutions = self._solutions()
            first = next(solutions)
            kind = type_of(first)
            solutions = itertools.chain([first], solutions)
            if not _chosen(first, slots):  # an action may have no choices
                some, rest = _taken(solutions, 2)
                if len(some) == 1:
                    return kind.call(first)
                solutions = itertools.chain(some, rest)
            return _Tries(kind, slots, solutions, budget, ahead).carried_out()

    def _solutions(self) -> Iterator[Solution]:
        """Yield the solutions; record the search for the first solution."""
        self.span.solution = first = self._designator.reference()
        found = self._designator.resolution()
        self.span.decision = Decision(
            environment=current_environment(),
            resolver=found.resolver,
            solution=found.index,
            known=found.known,
            complete=found.complete,
            module=type_of(first).recorded_as,
        )
        yield first
        yield from itertools.islice(self._designator.solutions(), 1, None)


class _Tries(FailureHandling):
    """The tries of an action's choices, in order; ``ahead`` limits the projections, and is None without projections."""

    def __init__(
        self,
        kind: ActionType,
        given: Mapping[str, Any],
        solutions: Iterator[Solution],
        budget: _Budget,
        ahead: Thinking | None,
    ) -> None:
        super().__init__(_ENDLESS)  # the budget limits the tries
        self._kind = kind
        self._given = given
        self._budget = budget
        self._tried: list[Try] = []
        self._found = solutions
        self._solutions = solutions if ahead is None else self._imagined(ahead)
        self._solution: Solution = {}
        self._spent = False  # whether choices were left out at the limits of projections

    @property
    def fields(self) -> dict[str, object]:
        return {"action": self._kind.type, "budget": self._budget.left}

    def carried_out(self) -> Any:
        """Try the choices in order; return the result of the first success, or raise ActionFailed."""
        self.parameters = self._next()
        with not_projecting():  # choices of subactions aren't projected
            return self.run(lambda **_: type_of(self._solution).call(self._solution))

    def recover(self, failure: BaseException) -> Mapping[str, Any]:
        """Return the next choice; raise ActionFailed if there is no next choice, or if the budget is spent."""
        self._tried.append(Try(self._choice(self._solution), failure))
        self._budget.spend()
        if self._budget.left <= 0:
            size = self._budget.spent
            own = sum(not each.imagined for each in self._tried)
            raise ActionFailed(self._kind.type, self._tried, spent=True, shared=size if own < size else 0)
        return self._next()

    def _next(self) -> Mapping[str, Any]:
        try:
            solution = next(self._solutions, None)
        except PlanFailure as last:
            raise ActionFailed(self._kind.type, self._tried, last=last) from last
        if solution is None:
            raise ActionFailed(self._kind.type, self._tried, spent=self._spent)
        self._solution = solution
        return self._choice(solution)

    def _choice(self, solution: Solution) -> dict[str, Any]:
        return _chosen(solution, self._given)

    def _imagined(self, ahead: Thinking) -> Iterator[Solution]:
        imagined, seconds = 0, 0.0
        while imagined < ahead.budget and (ahead.seconds is None or seconds < ahead.seconds):
            batch, self._found = _taken(self._found, min(_IN_PARALLEL[imagined > 0], ahead.budget - imagined))
            if not batch:
                return
            outcomes = imagine([(type_of(each), each, self._choice(each)) for each in batch])
            imagined += len(outcomes)
            for solution, outcome in zip(batch, outcomes, strict=False):
                seconds += outcome.duration
                if outcome.succeeded:
                    self._found = itertools.chain(batch[len(outcomes) :], self._found)
                    yield solution
                else:
                    assert outcome.failure is not None  # noqa: S101  a choice that didn't succeed has a failure
                    self._tried.append(Try(self._choice(solution), outcome.failure, imagined=True))
        self._spent = True


def _taken(solutions: Iterator[Solution], size: int) -> tuple[list[Solution], Iterator[Solution]]:
    """Return up to ``size`` solutions, and an iterator over the rest, which raises a later failure."""
    found: list[Solution] = []
    try:
        found.extend(itertools.islice(solutions, size))  # list() would lose the solutions before an error
    except PlanFailure as failure:
        if not found:
            raise
        return found, _raising(failure)
    return found, solutions


def _chosen(solution: Solution, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return a solution's values for the slots that the plan left open."""
    chosen: dict[str, Any] = {}
    for slot, value in solution.items():
        asked = given.get(slot)
        resolved = isinstance(asked, Designator) and not isinstance(value, Designator)
        if slot != "action" and value is not None and (asked is None or resolved):
            chosen[slot] = value
    return chosen


def _raising(failure: PlanFailure) -> Iterator[Solution]:
    raise failure
    yield {}
