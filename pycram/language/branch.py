"""Branches: the actions of a block, and what came of them."""

from __future__ import annotations

from contextvars import Context, copy_context
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import UsageError
from pycram.scheduling.cancellation import raise_if_cancelled, wait
from pycram.scheduling.future import unwrap
from recorder.tasks import State
from recorder.tracing.span import Span

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.language.actions import Result
    from pycram.scheduling.schedule import Condition


class NoResult(UsageError):
    """The result of a branch was used that was cancelled, since its block was decided without it.

    Attributes:
        branch: name of the branch.
    """

    def __init__(self, branch: str) -> None:
        super().__init__(
            f"{branch} has no result: it was cancelled when its block was decided; s.branches tells states"
        )
        self.branch = branch


def _nothing() -> None:
    """What there is to be done when all is over."""


_NOWHERE: Final = Context()


class Branch:
    """One action of a block, and what came of it.

    It runs in a copy of the context in which it was asked for.

    Attributes:
        name: what people call it.
        action: what it does; its result is the branch's. Let go of at the end, as it may be the block's own.
        ordered: whether it waits only for what was asked for before it, and so for nothing that comes later.
        context: where it was asked for; likewise.
        span: its node of the task tree.
        state: how far it is.
        error: what it raised; None while it runs, when it succeeded and when it was cancelled.
    """

    def __init__(
        self,
        name: str,
        action: Callable[[], Result],
        changed: Condition,
        *,
        ordered: bool = False,
        dropped: Callable[[], None] = _nothing,
        span: Span | None = None,
    ) -> None:
        """Makes a branch that doesn't run yet.

        Args:
            name: what people call it.
            action: what it does.
            changed: notified when it ends; its block's.
            ordered: see above.
            dropped: called once if it is never begun; must not raise.
            span: its node of the task tree, if it isn't just a branch.
        """
        self.name = name
        self.action = action
        self.ordered = ordered
        self.context = copy_context()
        self.span = span if span is not None else Span("branch", name)
        self.state = State.CREATED
        self.error: BaseException | None = None
        self._dropped = dropped
        self._begun = False
        self._changed = changed
        self._result: Result = None

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self.state not in (State.CREATED, State.RUNNING)

    def begin(self) -> Result:
        """Does its action; returns what that returned."""
        self._begun = True
        self.state = State.RUNNING
        return unwrap(self.action())

    def settle(self, state: State, result: Result = None, error: BaseException | None = None) -> None:
        """Says what came of it, once."""
        if not self._begun:
            self._dropped()
        self.action, self.context, self._dropped = _nothing, _NOWHERE, _nothing
        self._result, self.error = result, error
        self.state = state  # last: other threads may look at it
        self._changed.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """Waits for its end, at most so many seconds; returns whether it has ended.

        Raises:
            Cancelled: the one who waits was told to stop.
        """
        return wait(self._changed, lambda: self.done, timeout)

    def result(self, timeout: float | None = None) -> Result:
        """Waits for what its action returned, at most so many seconds.

        Raises:
            TimeoutError: it still runs.
            Cancelled: the one who waits was told to stop.
            NoResult: the branch was told to stop.
            BaseException: what its action raised.
        """
        if not self.wait(timeout):
            raise TimeoutError(f"{self.name} still runs after {timeout} s")
        if self.state is State.CANCELLED:
            raise_if_cancelled()
            raise NoResult(self.name)
        if self.error is not None:
            raise self.error
        return self._result

    def __repr__(self) -> str:
        return f"Branch({self.name!r}, {self.state.word})"
