"""Branches: the actions of a block, and their outcomes."""

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
    """The result of a cancelled branch was used; its block was decided without it.

    Attributes:
        branch: The branch's name.
    """

    def __init__(self, branch: str) -> None:
        super().__init__(f"{branch} has no result: it was cancelled when its block was decided; see s.branches")
        self.branch = branch


def _nothing() -> None:
    """Take the place of what an ended branch needs no more."""


_EMPTY_CONTEXT: Final = Context()


class Branch:
    """One action of a block, and its outcome.

    It runs in a copy of the context in which it was added. Action and context are released when it ends, as they may
    refer to the block.

    Args:
        name: Its name in records and messages.
        action: Returns the result.
        changed: The block's condition, notified when the branch ends.
        ordered: Whether it waits only for what was added before it.
        dropped: Called once if it never starts; must not raise.
        span: Its node of the task tree; by default of the kind "branch".

    Attributes:
        error: What it raised; None while it runs, after success, and after cancellation.
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
        """Run the action, and return its result."""
        self._begun = True
        self.state = State.RUNNING
        return unwrap(self.action())

    def settle(self, state: State, result: Result = None, error: BaseException | None = None) -> None:
        """Set its outcome, once."""
        if not self._begun:
            self._dropped()
        self.action, self.context, self._dropped = _nothing, _EMPTY_CONTEXT, _nothing
        self._result, self.error = result, error
        self.state = state  # last: other threads may read it
        self._changed.notify_all()

    def abandon(self, error: BaseException) -> None:
        """Fail it, unless it has ended: an error came between it and its end, such as that of a signal handler."""
        if not self.done:
            self.settle(State.FAILED, error=error)

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for its end, at most for a timeout in s; return whether it has ended.

        Raises:
            Cancelled: The waiting branch is cancelled.
        """
        return wait(self._changed, lambda: self.done, timeout)

    def result(self, timeout: float | None = None) -> Result:
        """Wait for its end, at most for a timeout in s; return its result, or raise what its action raised.

        Raises:
            TimeoutError: It still runs.
            Cancelled: The waiting branch is cancelled.
            NoResult: This branch was cancelled.
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
