"""Projecting choices before acting: they are tried in forks, and the first success is performed (thesis 6.3)."""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, PlanFailure
from pycram.projection import Outcome, project_all
from pycram.scheduling.cancellation import Binding

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pycram.actions.action import ActionType
    from pycram.motions.solutions import Solution

AT_ONCE: Final = (1, 4)
"""Numbers of choices that are imagined in parallel: in the first batch, as the best choice mostly succeeds; and later.

They don't depend on the number of cores, so a run has the same records everywhere.
"""

_BUDGET: Final = 8


@dataclass(frozen=True, slots=True)
class Thinking:
    """Limits of imagining choices."""

    budget: int = _BUDGET  # choices of an action
    seconds: float | None = None  # simulated time of all choices; None for no limit


_thinking: ContextVar[Thinking | None] = ContextVar("pycram_thinking", default=None)
_ended: ContextVar[bool] = ContextVar("pycram_thought", default=False)


def projecting(budget: int = _BUDGET, *, seconds: float | None = None) -> Binding[Thinking | None]:
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
        wanted: Whether the action itself asks for it; None if it has no such slot.
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
