"""Thinking before acting: choices are imagined in forks, and the first that succeeds is done (thesis 6.3)."""

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
"""How many choices are found before they are imagined, at first, as the best one mostly does, and then.

That is so whatever the number of cores: a run has the same records.
"""

_BUDGET: Final = 8


@dataclass(frozen=True, slots=True)
class Thinking:
    """How choices are imagined.

    Attributes:
        budget: How many of an action at most.
        seconds: Simulated time in all, after which no others are; None for no limit.
    """

    budget: int = _BUDGET
    seconds: float | None = None


_thinking: ContextVar[Thinking | None] = ContextVar("pycram_thinking", default=None)
_ended: ContextVar[bool] = ContextVar("pycram_thought", default=False)


def projecting(budget: int = _BUDGET, *, seconds: float | None = None) -> Binding[Thinking | None]:
    """Have the best choices of the actions in the ``with`` block imagined before one is done.

    For example::

        with projecting(budget=4):
            perform(ActionDesignator(type="transporting", object=milk, target="island"))

    They are done in copies of the process, on all cores, and the first in their order that succeeds is done for real;
    if none does, the action fails, and nothing has moved.

    Args:
        budget: How many choices of an action are imagined at most.
        seconds: Simulated time that these may take in all; no others are imagined after it.

    Raises:
        BadArgument: A limit is wrong.
    """
    if isinstance(budget, bool) or not isinstance(budget, int) or budget < 1:
        raise BadArgument("budget", budget, "a whole number of choices, from 1 up")
    if seconds is not None and checks.number("seconds", seconds) <= 0:
        raise BadArgument("seconds", seconds, "seconds of simulated time, more than 0")
    return Binding(_thinking, Thinking(budget, seconds))


def not_projecting() -> Binding[bool]:
    """Have nothing imagined in the ``with`` block, whatever its actions ask for."""
    return Binding(_ended, True)


def thinking(*, wanted: bool | None) -> Thinking | None:
    """Return how an action's choices are imagined here; None if they are not.

    Args:
        wanted: What the action itself says; None if nothing.
    """
    if _ended.get() or wanted is False:
        return None
    return _thinking.get() or (Thinking() if wanted else None)


def imagine(candidates: Sequence[tuple[ActionType, Solution, Mapping[str, Any]]]) -> list[Outcome]:
    """Do an action with several choices in copies of this process, up to the first that succeeds.

    Args:
        candidates: The action, its solution, and what was chosen in it, for records; in the order of preference.

    Returns:
        How these ended, in their order; only the last one may have succeeded.

    Raises:
        NotProjectable: The process can't be copied here.
        BaseException: What isn't a plan failure: one of these has it.
    """
    outcomes = project_all([partial(_Imagined(kind, solution), **choice) for kind, solution, choice in candidates])
    for outcome in outcomes:
        if outcome.failure is not None and not isinstance(outcome.failure, PlanFailure):
            raise outcome.failure
    return outcomes


class _Imagined:
    """An action with a solution, as the function that a projection calls."""

    def __init__(self, kind: ActionType, solution: Solution) -> None:
        self.__qualname__ = kind.type
        self._kind = kind
        self._solution = solution

    def __call__(self, **_: object) -> Any:
        with not_projecting():
            return self._kind.call(self._solution)
