"""Cleanup: actions at the end of a scope, also when it failed or was cancelled.

Python's own ``finally`` also runs when a branch is cancelled, but motions in it are cancelled like all others. Actions
of ``finally_`` are shielded from cancellation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pycram.foundation.errors import chained, raise_unchanged
from pycram.foundation.failures import BadArgument, PlanFailure
from pycram.language.branch import name_of, run
from pycram.language.failures import NotCleanedUp, Retry
from pycram.language.nesting import scope, sequential
from pycram.scheduling.cancellation import shielded
from recorder.tracing.span import Cancelled, span

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@scope
def finally_(action: Callable[..., Any], *args: object, **kwargs: object) -> Iterator[None]:
    """Run an action when the ``with`` block has ended, however it ended; in the block actions run in order.

    If both fail, the block's failure is raised with the cleanup's in its context; but a usage error takes precedence
    over a failure. If the cleanup of a cancelled block fails, NotCleanedUp fails the block that cancelled it.

    Raises:
        BadArgument: The action isn't callable.
        NotCleanedUp: The action failed after a cancellation.
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
            bug = isinstance(first, PlanFailure) and not isinstance(second, PlanFailure)
            if isinstance(first, Cancelled) and isinstance(second, PlanFailure):
                first = chained(NotCleanedUp(name_of(action), second), [first])
            elif bug or isinstance(first, (Cancelled, Retry)):
                first = chained(second, [first])
            else:
                first = chained(first, [second])
    if first is not None:
        raise_unchanged(first)
