"""Failure handling: retries after plan failures, with the same or other parameters (thesis 3.5.3).

Python runs the body of a ``with`` statement once, so a plan needs a loop, here with at most six attempts::

    handling = failure_handling(5, arm="left").on(Unreachable, lambda _: {"arm": "right"}).on(InCollision, step_back)
    for attempt in handling:
        with attempt:
            pick_up(milk, attempt["arm"])
"""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Any, NoReturn, Self, TypeAlias

from pycram.foundation.errors import OnError, chained, raise_unchanged
from pycram.foundation.failures import BadArgument, PlanFailure, UsageError
from pycram.language.branch import run
from pycram.language.failures import Retry, leaves_uncleaned
from pycram.language.nesting import Scope, sequential
from pycram.scheduling.cancellation import Binding, current_scope
from recorder.records import format_error
from recorder.tracing.call_stack import call_site
from recorder.tracing.span import Span

Result: TypeAlias = Any
Parameters: TypeAlias = Mapping[str, Any]
#: A function that is called with a failure before the next attempt, and may return parameters for that attempt.
Recovery: TypeAlias = Callable[[Any], "Parameters | None"]

_attempt: ContextVar[Attempt | None] = ContextVar("pycram_attempt", default=None)


class RetriesUsedUp(PlanFailure):
    """A plan called ``retry`` outside of ``except``, and no retry was left."""

    def __init__(self, retries: int) -> None:
        super().__init__(f"all {retries} retries are used up")
        self.retries = retries  # number of retries


class FailureLeft(RuntimeWarning):
    """A plan left the loop after a failed attempt, as with ``break``; Python can't raise the failure any more."""


class FailureHandling:
    """Runs code again after certain failures, a limited number of times; reusable, also concurrently.

    Args:
        retries: 0 or more; 5 retries make up to 6 attempts.
        kinds: Types of failures that are retried; by default all plan failures.
        parameters: Parameters of the attempts; a recovery or ``retry`` may change them.

    Raises:
        BadArgument: ``retries`` is below 0, or a type isn't a type of plan failures.
    """

    def __init__(self, retries: int, *kinds: type[PlanFailure], **parameters: object) -> None:
        if isinstance(retries, bool) or not isinstance(retries, int) or retries < 0:
            raise BadArgument("retries", retries, "a whole number from 0 up")
        self.retries = retries
        self.parameters: Parameters = parameters
        self.kinds = tuple(_failure_type(kind) for kind in kinds) or (PlanFailure,)
        self._recoveries: list[tuple[type[PlanFailure], Recovery]] = []

    def on(self, kind: type[PlanFailure], recovery: Recovery) -> Self:
        """Add a recovery for a type of failures; return this handling.

        Before the next attempt, the first recovery that matches the failure is called. A recovery may return parameters
        for that attempt: in a loop, only parameters that the handling has. An error of the recovery ends the handling.

        Raises:
            BadArgument: ``kind`` isn't a type of failures, or the recovery isn't a function.
        """
        if not callable(recovery):
            raise BadArgument(
                "recovery", recovery, "a function of the failure, such as lambda failure: {'arm': 'left'}"
            )
        self._recoveries.append((_failure_type(kind), recovery))
        return self

    @property
    def fields(self) -> dict[str, object]:
        """The parameters of the handling's node of the task tree; the tries of actions have others."""
        kinds = [kind.__name__ for kind in self.kinds]
        return {"retries": self.retries} | ({} if kinds == ["PlanFailure"] else {"kinds": kinds})

    def handles(self, error: BaseException | None) -> bool:
        """Return whether to retry after an error."""
        # in a cancelled branch, the cancellation of the next attempt would hide the failure of a cleanup
        hidden = error is not None and _is_cancelled() and leaves_uncleaned(error)
        return isinstance(error, self.kinds) and not hidden

    def recover(self, failure: BaseException) -> Parameters:
        """Run the recovery of a failure, and return the changed parameters."""
        for kind, recovery in self._recoveries:
            if isinstance(failure, kind):
                changed = recovery(failure)
                if changed is not None and not isinstance(changed, Mapping):
                    raise BadArgument("result of the recovery", changed, "parameters by name, or None")
                return changed or {}
        return {}

    def __iter__(self) -> Iterator[Attempt]:
        """Yield an attempt for a ``with`` statement, until an attempt succeeds."""
        yield from self._attempts({*self.parameters})

    def _attempts(self, names: set[str]) -> Iterator[Attempt]:
        attempts = Attempts(self, names)
        try:
            while not attempts.over:
                attempt = attempts.following()
                yield attempt
                if not attempt.used:
                    raise UsageError("the body of `for attempt in failure_handling(5):` must be `with attempt:`")
        finally:
            attempts.close()

    def run(self, action: Callable[..., Result], *args: object, **kwargs: object) -> Result:
        """Call a function until it succeeds; return its result, or raise the last failure.

        The parameters of an attempt override keyword arguments.
        """
        result: Result = None
        for attempt in self._attempts(set()):  # a recovery may change arguments of the call
            with attempt:
                result = run(action, *args, **{**kwargs, **attempt.parameters})
        return result

    def __call__(self, function: Callable[..., Result]) -> Callable[..., Result]:
        """Decorate a function so that its calls are retried."""

        @functools.wraps(function)
        def handled(*args: object, **kwargs: object) -> Result:
            return self.run(function, *args, **kwargs)

        return handled

    def __enter__(self) -> NoReturn:
        raise UsageError(
            "Python runs the body of a with statement once; "
            f"write `for attempt in failure_handling({self.retries}):` and in it `with attempt:`"
        )

    def __exit__(self, *_: object) -> None:
        """Complete the protocol of context managers; never called, because ``__enter__`` raises."""


failure_handling = FailureHandling


def _failure_type(kind: type[PlanFailure]) -> type[PlanFailure]:
    if not (isinstance(kind, type) and issubclass(kind, PlanFailure)):
        raise BadArgument("kind", kind, "a type of plan failures; other errors aren't retried")
    return kind


def _check_names(changed: Parameters, names: set[str]) -> None:
    if names and not {*changed} <= names:
        raise BadArgument("changed parameters", changed, f"only {', '.join(sorted(names))}, which the handling has")


def retry(**changed: object) -> NoReturn:
    """End this attempt and start the next one, with changed parameters.

    Raises:
        UsageError: The call is outside of an attempt, or the plan handles a usage error, which is raised again.
    """
    attempt = _attempt.get()
    error = sys.exc_info()[1]
    if isinstance(error, UsageError):
        raise error
    if attempt is None:
        raise UsageError("call retry() in the body of `with attempt:` in `for attempt in failure_handling(5):`")
    raise Retry(attempt, attempt.number, changed, error)


class Attempt(Scope["Attempt"]):
    """One run of code that may be retried."""

    def __init__(self, attempts: Attempts, number: int, parameters: Parameters, failures: list[BaseException]) -> None:
        super().__init__("failure_handling")
        self.number = number  # number of the attempt, from 1
        self.parameters = parameters
        self.failures = tuple(failures)  # failures of the earlier attempts
        self.used = False  # whether a ``with`` statement has used this attempt
        self._attempts = attempts

    def __getitem__(self, name: str) -> Any:
        """Return a parameter."""
        return self.parameters[name]

    def _opened(self) -> AbstractContextManager[Attempt]:
        if self.used:
            raise UsageError(f"attempt {self.number} was already made; the loop yields the next attempt")
        self.used = True
        return self._run()

    @contextmanager
    def _run(self) -> Iterator[Attempt]:
        raised: BaseException | None = None
        handled: BaseException | None = None  # the failure that was handled; after ``retry`` it differs from ``raised``
        changed: Parameters | None = None
        with OnError(self._attempts.finish), self._attempts.entered():  # starting or recording may fail
            span = Span("attempt", f"attempt {self.number}", parameters=self.parameters, attempt=self.number)
            with span, Binding(_attempt, self):
                try:
                    yield self
                except BaseException as error:  # noqa: BLE001  the error is raised below, unless it is handled
                    raised = handled = span.error = error
                    if isinstance(error, Retry) and error.attempt is self:
                        handled, changed = error.error or error, error.changed
                        span.error = handled
        if not self._attempts.ended(raised, handled, changed) and raised is not None:
            raise_unchanged(raised)


class Attempts:
    """The attempts of one loop over a failure handling."""

    def __init__(self, handling: FailureHandling, names: set[str]) -> None:
        self.over = False
        self._names = names  # names of parameters that an attempt may change; empty for all names
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
        """Run the ``with`` block in the handling's node of the task tree; the first call starts that node."""
        with sequential():
            if self._span is None:
                self._span = Span("failure-handling", "failure-handling", parameters=self._handling.fields)
                self._span.start()
            with self._span.entered():
                yield

    def ended(self, error: BaseException | None, handled: BaseException | None, changed: Parameters | None) -> bool:
        """Return whether another attempt follows.

        If not, the caller raises ``error``, or this method raises the last failure. ``handled`` is the failure to
        handle: after ``retry``, the failure that the plan was handling. ``changed`` contains parameters for the next
        attempt; None without ``retry``.
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
                    _check_names(changed, self._names)
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
        """End the handling if the plan left its loop between two attempts; warn if the last attempt has failed."""
        if not self.over:
            last = self._failures[-1] if self._failures else None
            self.finish(last)
            if last is not None and not _is_cancelled():
                text = f"the loop was left after attempt {self._number} failed: {format_error(last)}"
                warnings.warn_explicit(text, FailureLeft, *call_site())

    def finish(self, error: BaseException | None) -> None:
        """End the handling; ``error`` is None if an attempt succeeded."""
        self.over = True
        if self._span is not None:
            self._span.finish(error)


def _is_cancelled() -> bool:
    scope = current_scope()
    return scope is not None and scope.is_cancelled
