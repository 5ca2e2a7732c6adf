"""Attempts: runs of the same code, one after the other, until one succeeds or their failure handling gives up."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from pycram.foundation.error_chain import chained, raise_unchanged
from pycram.foundation.failures import PlanFailure, UsageError
from pycram.language.body import sequential
from pycram.language.nesting import Scope
from pycram.scheduling.cancellation import Binding, current_scope
from recorder.records import format_error
from recorder.tracing.call_stack import call_site
from recorder.tracing.span import Span

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from pycram.language.retries import FailureHandling

Parameters: TypeAlias = Mapping[str, Any]


class RetriesUsedUp(PlanFailure):
    """``retry`` was called while no failure was being handled, and no retry was left.

    Attributes:
        retries: Number of retries there had been.
    """

    def __init__(self, retries: int) -> None:
        super().__init__(f"all {retries} retries are used up")
        self.retries = retries


class FailureLeft(RuntimeWarning):
    """A plan left the loop of a failure handling after a failed attempt; the failure was neither handled nor raised."""


class Retry(BaseException):
    """Rises from ``retry`` to its attempt; nothing else catches it.

    Attributes:
        attempt: The attempt that it ends.
        changed: Changed parameters of the next attempt.
        error: The error that was being handled.
    """

    def __init__(self, attempt: Attempt, changed: Parameters, error: BaseException | None) -> None:
        super().__init__(f"attempt {attempt.number} is to be followed by another one")
        self.attempt = attempt
        self.changed = changed
        self.error = error


_attempt: ContextVar[Attempt | None] = ContextVar("pycram_attempt", default=None)


def retry(**changed: object) -> NoReturn:
    """End this attempt and start the next one, with changed parameters.

    Raises:
        UsageError: There is no attempt here; or a usage error is being handled, which is raised again.
    """
    attempt = _attempt.get()
    error = sys.exc_info()[1]
    if isinstance(error, UsageError):
        raise error
    if attempt is None:
        raise UsageError("retry() belongs into the body of `with attempt:` in `for attempt in failure_handling(5):`")
    raise Retry(attempt, changed, error)


class Attempt(Scope["Attempt"]):
    """One run of code that may be tried again.

    Attributes:
        number: From 1.
        parameters: Parameters of this attempt, by name.
        failures: Failures of the attempts before it.
        used: Whether its body has run.
    """

    def __init__(self, attempts: Attempts, number: int, parameters: Parameters, failures: list[BaseException]) -> None:
        super().__init__("failure_handling")
        self.number = number
        self.parameters = parameters
        self.failures = tuple(failures)
        self.used = False
        self._attempts = attempts

    def __getitem__(self, name: str) -> Any:
        """Return a parameter."""
        return self.parameters[name]

    def _opened(self) -> AbstractContextManager[Attempt]:
        if self.used:
            raise UsageError(f"attempt {self.number} has been made already; the loop gives the next one")
        self.used = True
        return self._run()

    @contextmanager
    def _run(self) -> Iterator[Attempt]:
        raised: BaseException | None = None
        handled: BaseException | None = None  # its failure: another error than ``raised`` after ``retry``
        changed: Parameters | None = None
        try:
            with self._attempts.entered():
                span = Span("attempt", f"attempt {self.number}", parameters=self.parameters, attempt=self.number)
                with span, Binding(_attempt, self):
                    try:
                        yield self
                    except BaseException as error:  # noqa: BLE001  raised below, unless it is handled
                        raised = handled = span.error = error
                        if isinstance(error, Retry) and error.attempt is self:
                            handled, changed = error.error or error, error.changed
                            span.error = handled
        except BaseException as error:  # it has not started, or can't be recorded
            self._attempts.finish(error)
            raise
        if not self._attempts.ended(raised, handled, changed) and raised is not None:
            raise_unchanged(raised)


class Attempts:
    """The attempts of one loop of a failure handling."""

    def __init__(self, handling: FailureHandling) -> None:
        self.over = False
        self._handling = handling
        self._parameters = handling.parameters
        self._failures: list[BaseException] = []
        self._span: Span | None = None
        self._number = 0

    def following(self) -> Attempt:
        """Return the next attempt."""
        self._number += 1
        return Attempt(self, self._number, self._parameters, self._failures)

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Run the ``with`` block in the handling's node of the task tree, which starts with the first attempt."""
        with sequential():
            if self._span is None:
                self._span = Span("failure-handling", "failure-handling", parameters=self._handling.fields)
                self._span.start()
            with self._span.entered():
                yield

    def ended(self, error: BaseException | None, handled: BaseException | None, changed: Parameters | None) -> bool:
        """Decide what follows the end of an attempt: return True for another one, False to raise its error.

        Args:
            error: The error that left its body.
            handled: Its failure; another error than ``error`` after ``retry``.
            changed: Changed parameters for the next attempt; None without ``retry``.

        Raises:
            PlanFailure: The last failure, when the retries are used up.
        """
        if handled is None or (changed is None and not self._handling.handles(handled)):
            self.finish(error)
            return False
        last = RetriesUsedUp(self._handling.retries) if isinstance(handled, Retry) else handled
        final: BaseException = chained(last, reversed(self._failures))
        if self._number <= self._handling.retries:
            try:
                with self.entered():
                    changed = self._handling.recover(last) if changed is None else changed
            except BaseException as recovery_error:  # noqa: BLE001  raised below
                final = chained(recovery_error, [final])
            else:
                self._failures.append(last)
                self._parameters = {**self._parameters, **changed}
                return True
        self.finish(final)
        if final is not error:
            raise_unchanged(final)
        return False

    def close(self) -> None:
        """End the handling if the plan left its loop between two attempts; warn if the last one failed."""
        if not self.over:
            last = self._failures[-1] if self._failures else None
            self.finish(last)
            if last is not None and not is_cancelled():
                text = f"the loop was left after attempt {self._number} had failed: {format_error(last)}"
                warnings.warn_explicit(text, FailureLeft, *call_site())

    def finish(self, error: BaseException | None) -> None:
        """End the handling; without an error an attempt succeeded."""
        self.over = True
        if self._span is not None:
            self._span.finish(error)


def is_cancelled() -> bool:
    """Whether the running code is cancelled, by a block around it or a timeout."""
    scope = current_scope()
    return scope is not None and scope.is_cancelled
