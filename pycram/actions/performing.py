"""Performing actions: choices are tried in order, each a task, until one succeeds or the budget is spent.

In ``projecting()``, the best choices are tried in forks first, and the first success is performed (thesis 6.3).
"""

from __future__ import annotations

import itertools
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from pycram.actions.action import ActionDesignator, ActionType, prepared, type_of
from pycram.actions.advice import advice
from pycram.foundation import checks
from pycram.foundation.errors import export
from pycram.foundation.failures import BadArgument, PlanFailure, PycramError
from pycram.foundation.refusals import refusing
from pycram.language.branch import current_block
from pycram.language.retries import FailureHandling
from pycram.motions.designator import Designator, MotionDesignator, performing
from pycram.motions.process_module import current_environment
from pycram.motions.slots import DesignatorError
from pycram.process_module import ProcessModule
from pycram.projection import Outcome, is_projected, project_all
from pycram.reasoning.places.remedies import aside
from pycram.scheduling.cancellation import Binding, checkpoint
from pycram.world.world import BulletWorld
from recorder.records import Decision, format_error
from recorder.tracing.span import Span

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.actions.action import ActionType
    from pycram.motions.designator import Solution


BUDGET: Final = 20
"""Default number of tries that may fail, of an action and its subactions."""

_ENDLESS: Final = 10**9  # retries; only the budget limits them
_MAX_REASONS: Final = 4  # kinds of failures in the message of an ActionFailed
_MAX_IMAGINED: Final = 8  # choices of an action that are imagined by default
#: Choices that are imagined in parallel: in the first batch, because the best choice mostly succeeds, and later.
#: The numbers don't depend on the number of cores, so a run has the same records everywhere.
_IN_PARALLEL: Final = (1, 4)


@dataclass(frozen=True, slots=True)
class Thinking:
    """Limits of imagining choices."""

    budget: int = _MAX_IMAGINED  # choices of an action
    seconds: float | None = None  # simulated time of all choices; None for no limit


_thinking: ContextVar[Thinking | None] = ContextVar("pycram_thinking", default=None)
_ended: ContextVar[bool] = ContextVar("pycram_thought", default=False)


def projecting(budget: int = _MAX_IMAGINED, *, seconds: float | None = None) -> Binding[Thinking | None]:
    """Imagine the best choices of the actions in the ``with`` block before one is performed.

    For example::

        with projecting(budget=4):
            perform(ActionDesignator(type="transporting", object=milk, target="island"))

    They run in copies of the process, on all cores, and the first success in their order is performed. If all fail,
    the action fails, and nothing has moved.

    Args:
        budget: Maximum number of imagined choices of an action.
        seconds: Simulated time after which no more choices are imagined.

    Raises:
        BadArgument: A limit is wrong.
    """
    if isinstance(budget, bool) or not isinstance(budget, int) or budget < 1:
        raise BadArgument("budget", budget, "a whole number of choices, from 1 up")
    if seconds is not None and checks.number("seconds", seconds) <= 0:
        raise BadArgument("seconds", seconds, "seconds of simulated time, more than 0")
    return Binding(_thinking, Thinking(budget, seconds))


def not_projecting() -> Binding[bool]:
    """Imagine nothing in the ``with`` block, even if its actions ask for it."""
    return Binding(_ended, True)


def thinking(*, wanted: bool | None) -> Thinking | None:
    """Return the limits of imagining an action's choices here; None if they are not imagined.

    Args:
        wanted: The action's slot ``projected``; None if it isn't given.
    """
    if _ended.get() or wanted is False:
        return None
    return _thinking.get() or (Thinking() if wanted else None)


def imagine(candidates: Sequence[tuple[ActionType, Solution, Mapping[str, Any]]]) -> list[Outcome]:
    """Perform choices of an action in copies of this process, up to the first success; return their outcomes.

    Args:
        candidates: The action, its solution, and the chosen slots for records; in the order of preference.

    Raises:
        NotProjectable: The process can't be copied here.
        BaseException: The error of a choice, if it isn't a plan failure.
    """
    outcomes = project_all([partial(_Imagined(kind, solution), **choice) for kind, solution, choice in candidates])
    for outcome in outcomes:
        if outcome.failure is not None and not isinstance(outcome.failure, PlanFailure):
            raise outcome.failure
    return outcomes


class _Imagined:
    """An action with a solution, as a function to project."""

    def __init__(self, kind: ActionType, solution: Solution) -> None:
        self.__qualname__ = kind.type
        self._kind = kind
        self._solution = solution

    def __call__(self, **_: object) -> Any:
        with not_projecting():
            return self._kind.call(self._solution)


@dataclass(frozen=True, slots=True)
class Try:
    """A choice that failed."""

    choice: Mapping[str, Any]  # chosen values by slot
    failure: BaseException
    imagined: bool = False  # whether it was only tried in a projection


class ActionFailed(PlanFailure):
    """All tried choices failed, or the budget was spent."""

    def __init__(
        self, action: str, tried: Sequence[Try], *, spent: bool = False, last: BaseException | None = None
    ) -> None:
        count = f"{len(tried)} {'try' if len(tried) == 1 else 'tries'}"
        ending = "the budget is spent" if spent else "there is nothing else to try"
        remedy = _remedy(tried)
        super().__init__(f"{action} failed after {count}, {ending}{_summary(tried, last)}{remedy and '; ' + remedy}")
        self.action = action  # type of the action
        self.tried = list(tried)  # the failed choices, in order, each with its failure
        self.spent = spent  # whether the budget was spent: there may be other choices
        self.last = last  # why no further choice was found; None if there are no further choices


export("pycram.actions", ActionFailed)


def _summary(tried: Sequence[Try], last: BaseException | None) -> str:
    """Return the failures of tries as text, the commonest first; equal failures are counted."""
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
    """Return the advice to move objects aside that were in the way in each try; "" without such objects."""
    world = BulletWorld.current_bullet_world
    blocking = [getattr(each.failure, "bodies", None) for each in tried]
    if world is None or not blocking or not all(blocking):
        return ""
    every = [name for name in blocking[0] or () if all(name in (bodies or ()) for bodies in blocking)]
    return aside(every, world.objects)


def _reason(failure: BaseException) -> str:
    """Return a failure as one line; for a failed action, its first failure."""
    while isinstance(failure, ActionFailed) and failure.tried:
        failure = failure.tried[0].failure
    return format_error(failure).partition("\n")[0]


class _Budget:
    """The number of tries that may still fail, of an action and of the actions around it."""

    def __init__(self, tries: int, around: _Budget | None) -> None:
        self._left = tries
        self._around = around

    @property
    def left(self) -> int:
        return self._left if self._around is None else min(self._left, self._around.left)

    def spend(self) -> None:
        self._left -= 1
        if self._around is not None:
            self._around.spend()


_budget: ContextVar[_Budget | None] = ContextVar("pycram_budget", default=None)
_takes: ContextVar[bool] = ContextVar("pycram_takes", default=False)  # whether an action around has an object


def perform(designator: ActionDesignator | MotionDesignator) -> Any:
    """Perform an action or a motion, and return its result, or a future in the body of a block with branches.

    An action's choices are tried in order, until one succeeds.

    Raises:
        DesignatorError: It isn't a designator of an action or motion, or a slot is missing, unknown or wrong.
        ActionFailed: No choice succeeded, or the budget is spent.
        PlanFailure: The failure of an action without choices, or the reason why no choice was found.
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
        designator.check()  # a resolver of the plan could know other slots
    return _Act(designator)


class _Act:
    """An action from its request to its end."""

    def __init__(self, designator: ActionDesignator) -> None:
        slots = {key: value for key, value in designator.description if key != "type"}
        self.span = Span("action", designator.type, parameters=slots)
        self._designator = designator

    def carry_out(self) -> Any:
        """Wait for the futures in its slots, and try its choices."""
        for branch in self._designator.branches():
            branch.result()
        checkpoint()
        slots = dict(self._designator.description)
        outermost = "object" in slots and not (_takes.get() or is_projected())
        with performing(self._designator), Binding(_takes, _takes.get() or outermost):
            try:
                return self._carried_out(slots)
            except PlanFailure as failure:
                with suppress(PycramError):  # the world may have ended
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
            if not _chosen(first, slots):  # there may be nothing to choose
                some, rest = _taken(solutions, 2)
                if len(some) == 1:
                    return kind.call(first)
                solutions = itertools.chain(some, rest)
            return _Tries(kind, slots, solutions, budget, ahead).carried_out()

    def _solutions(self) -> Iterator[Solution]:
        """Yield its solutions; record the search for the first solution."""
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
    """The choices of an action, tried in order.

    Args:
        kind: The action.
        given: Its given slots; its solutions choose values for the others.
        solutions: Its solutions, at least one.
        budget: The number of tries that may still fail.
        ahead: The limits of imagining choices first; None if they are not imagined.
    """

    def __init__(
        self,
        kind: ActionType,
        given: Mapping[str, Any],
        solutions: Iterator[Solution],
        budget: _Budget,
        ahead: Thinking | None,
    ) -> None:
        super().__init__(_ENDLESS)  # the budget ends it
        self._kind = kind
        self._given = given
        self._budget = budget
        self._tried: list[Try] = []
        self._found = solutions
        self._solutions = solutions if ahead is None else self._imagined(ahead)
        self._solution: Solution = {}
        self._spent = False  # whether the limits left out choices

    @property
    def fields(self) -> dict[str, object]:
        """The parameters of its node of the task tree."""
        return {"action": self._kind.type, "budget": self._budget.left}

    def carried_out(self) -> Any:
        """Try the choices in order, and return the result of the first success.

        Raises:
            ActionFailed: None succeeded.
        """
        self.parameters = self._next()
        with not_projecting():  # subactions of imagined choices imagine nothing
            return self.run(lambda **_: type_of(self._solution).call(self._solution))

    def recover(self, failure: BaseException) -> Mapping[str, Any]:
        """Return the choice of the next attempt.

        Raises:
            ActionFailed: There is none, or the budget is spent.
        """
        self._tried.append(Try(self._choice(self._solution), failure))
        self._budget.spend()
        if self._budget.left <= 0:
            raise ActionFailed(self._kind.type, self._tried, spent=True)
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
        """Yield the solutions that succeed in projections, in order."""
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
                    assert outcome.failure is not None  # noqa: S101  it hasn't succeeded
                    self._tried.append(Try(self._choice(solution), outcome.failure, imagined=True))
        self._spent = True


def _taken(solutions: Iterator[Solution], size: int) -> tuple[list[Solution], Iterator[Solution]]:
    """Return the next solutions, and the rest; a failure to find more is raised from the rest."""
    found: list[Solution] = []
    try:
        found.extend(itertools.islice(solutions, size))  # keeps the solutions before an error
    except PlanFailure as failure:
        if not found:
            raise
        return found, _raising(failure)
    return found, solutions


def _chosen(solution: Solution, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a solution for the action's open slots."""
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
