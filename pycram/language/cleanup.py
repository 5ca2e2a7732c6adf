"""Cleaning up: what a plan does at the end of a scope, however that ended, also when it was cancelled.

Python's own ``finally`` runs too when a branch is cancelled, but the motions in it are stopped like all others. What is
done here is shielded from that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pycram.foundation.error_chain import chained, raise_unchanged
from pycram.foundation.failures import BadArgument, PlanFailure
from pycram.language.actions import name_of, run
from pycram.language.attempts import Retry
from pycram.language.body import sequential
from pycram.language.failures import NotCleanedUp
from pycram.language.nesting import scope
from pycram.scheduling.cancellation import Cancelled, shielded
from recorder.tracing.span import span

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@scope
def finally_(action: Callable[..., Any], *args: object, **kwargs: object) -> Iterator[None]:
    """Does something when its block has ended, however it did. In the block actions happen one after the other.

    When both the block and the cleaning up fail, the block's failure is raised with the other in its context; but a
    usage error goes before a failure. Where the block was cancelled, a failure of the cleaning up is NotCleanedUp,
    which fails the block of the plan that cancelled it.

    Args:
        action: what to do.
        args: its arguments.
        kwargs: its named arguments.

    Raises:
        BadArgument: it can't be called.
        NotCleanedUp: it failed when the block had been told to stop.
    """
    if not callable(action):
        raise BadArgument("action", action, "a function")
    first: BaseException | None = None
    with sequential() as settle:
        try:
            yield
            settle()
        except BaseException as error:  # noqa: BLE001  raised below
            first = error
        try:
            with shielded(), span("cleanup", name_of(action)) as task:
                task.result = run(action, *args, **kwargs)
        except BaseException as second:
            if first is None:
                raise
            first = _together(first, second, name_of(action))
    if first is not None:
        raise_unchanged(first)


def _together(error: BaseException, cleaning: BaseException, action: str) -> BaseException:
    bug = isinstance(error, PlanFailure) and not isinstance(cleaning, PlanFailure)
    if isinstance(error, Cancelled) and isinstance(cleaning, PlanFailure):
        return chained(NotCleanedUp(action, cleaning), [error])
    if bug or isinstance(error, (Cancelled, Retry)):
        return chained(cleaning, [error])
    return chained(error, [cleaning])
