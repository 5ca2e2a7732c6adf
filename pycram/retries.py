"""Failure handling: trying again after a plan failure, with the same or other parameters (thesis 3.5.3).

In CRAM, ``with-failure-handling`` runs its body again when the body says ``retry``. A ``with`` statement of Python runs
its body once, so here a loop goes around it::

    for attempt in failure_handling(5, arm="left"):
        with attempt:
            pick_up(milk, attempt["arm"])

runs the body until it gets through, at most six times: once, and five retries. When they are used up, the last failure
is raised, with the earlier ones in its context. What to do between two attempts can be said by the type of failure::

    handling = failure_handling(5).on(Unreachable, lambda failure: {"arm": "right"}).on(InCollision, step_back)

or in the body itself, where ``retry`` ends the attempt as the original's does::

        with attempt:
            try:
                pick_up(milk, attempt["arm"])
            except Unreachable:
                retry(arm="right")

The same for a function: ``failure_handling(5).run(pick_up, milk)``, or ``@failure_handling(5)`` before its definition.
Only plan failures are tried again. In the body of an attempt actions happen one after the other.

What follows ``with attempt`` in the loop happens after failed attempts too. Who leaves the loop there, by ``break`` or
``return``, drops a failure that nobody has handled: Python lets nothing be raised then, so :class:`FailureLeft` warns
of it. To give up, raise something or handle the failure inside of ``with attempt``.
"""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from pycram.actions import run
from pycram.cancellation import current_scope
from pycram.error_chain import chained, raise_unchanged
from pycram.failed_blocks import leaves_uncleaned
from pycram.failures import BadArgument, PlanFailure, UsageError
from pycram.nesting import Nested
from pycram.open_block import alone
from recorder.interrupts import Uninterrupted
from recorder.records import told_error
from recorder.span import Span
from recorder.way import plan_line

if TYPE_CHECKING:
    from contextlib import AbstractContextManager
    from types import TracebackType

    from typing_extensions import Self

Result: TypeAlias = Any
Parameters: TypeAlias = Mapping[str, Any]
#: Gets a failure, does something about it, and may give parameters that the next attempt is to have.
Recovery: TypeAlias = Callable[[Any], "Parameters | None"]


class RetriesUsedUp(PlanFailure):
    """``retry`` was called without a failure at hand, and no retry was left.

    Attributes:
        retries: how many there had been.
    """

    def __init__(self, retries: int) -> None:
        super().__init__(f"all {retries} retries are used up")
        self.retries = retries


class FailureLeft(RuntimeWarning):
    """A plan left the loop of a failure handling after a failed attempt; the failure was neither handled nor raised."""


class Retry(BaseException):
    """Rises from ``retry`` to its attempt; nothing else catches it.

    Attributes:
        attempt: the attempt that is over.
        changed: parameters that the next one is to have.
        error: what was being handled.
    """

    def __init__(self, attempt: Attempt, changed: Parameters, error: BaseException | None) -> None:
        super().__init__(f"attempt {attempt.number} is to be followed by another one")
        self.attempt = attempt
        self.changed = changed
        self.error = error


_attempt: ContextVar[Attempt | None] = ContextVar("pycram_attempt", default=None)


def retry(**changed: object) -> NoReturn:
    """Ends this attempt and begins the next one.

    Args:
        changed: parameters that the next one is to have.

    Raises:
        UsageError: there is no attempt here; or it is called while a usage error is handled, which comes out.
    """
    attempt = _attempt.get()
    error = sys.exc_info()[1]
    if isinstance(error, UsageError):
        raise error
    if attempt is None:
        raise UsageError("retry() belongs into the body of `with attempt:` in `for attempt in failure_handling(5):`")
    raise Retry(attempt, changed, error)


class FailureHandling:
    """How often, and after what, something is tried again. May be used for many things, also at the same time."""

    def __init__(self, retries: int, *kinds: type[PlanFailure], **parameters: object) -> None:
        """Says how failures are handled.

        Args:
            retries: how often to try again: with 5, there are up to 6 attempts.
            kinds: the types of failures to try again after; all plan failures by default.
            parameters: what the attempts are to have, until something changes them.

        Raises:
            BadArgument: retries below 0, or a type that isn't one of plan failures.
        """
        if isinstance(retries, bool) or not isinstance(retries, int) or retries < 0:
            raise BadArgument("retries", retries, "a whole number from 0 up")
        self.retries = retries
        self.parameters: Parameters = parameters
        self.kinds = tuple(_failure_type(kind) for kind in kinds) or (PlanFailure,)
        self._recoveries: list[tuple[type[PlanFailure], Recovery]] = []

    def on(self, kind: type[PlanFailure], recovery: Recovery) -> Self:
        """Says what to do after a failure, before the next attempt.

        Args:
            kind: the type of failure; the first that was said for a failure counts.
            recovery: gets the failure; may return parameters for the next attempt. What it raises ends the handling.

        Returns:
            This very handling.
        """
        self._recoveries.append((_failure_type(kind), recovery))
        return self

    @property
    def told(self) -> dict[str, object]:
        """What its node of the task tree tells of it."""
        kinds = [kind.__name__ for kind in self.kinds]
        return {"retries": self.retries} | ({} if kinds == ["PlanFailure"] else {"kinds": kinds})

    def handles(self, error: BaseException | None) -> bool:
        """Whether there is to be another attempt after an error, if one is left.

        None after a cleaning up that failed because the handling itself is told to stop: being stopped again would
        hide it.
        """
        hidden = error is not None and _told_to_stop() and leaves_uncleaned(error)
        return isinstance(error, self.kinds) and not hidden

    def recover(self, failure: BaseException) -> Parameters:
        """Does what was said about a failure.

        Args:
            failure: a plan failure.

        Returns:
            The parameters that the next attempt is to have instead.

        Raises:
            BadArgument: a recovery gave something else.
        """
        for kind, recovery in self._recoveries:
            if isinstance(failure, kind):
                changed = recovery(failure)
                if changed is not None and not isinstance(changed, Mapping):
                    raise BadArgument("result of the recovery", changed, "parameters by name, or None")
                return changed or {}
        return {}

    def __iter__(self) -> Iterator[Attempt]:
        """The attempts, until one succeeds; each is to be used with ``with``."""
        attempts = _Attempts(self)
        try:
            while not attempts.over:
                attempt = attempts.following()
                yield attempt
                if not attempt.used:
                    raise UsageError("the body of `for attempt in failure_handling(5):` has to be `with attempt:`")
        finally:
            attempts.close()

    def run(self, action: Callable[..., Result], *args: object, **kwargs: object) -> Result:
        """Calls a function until it gets through.

        Args:
            action: the function.
            args: its arguments.
            kwargs: its named arguments; an attempt's parameters go before them.

        Returns:
            What it returned.

        Raises:
            PlanFailure: its last failure.
        """
        result: Result = None
        for attempt in self:
            with attempt:
                result = run(action, *args, **{**kwargs, **attempt.parameters})
        return result

    def __call__(self, function: Callable[..., Result]) -> Callable[..., Result]:
        """As a decorator: the function handles its failures itself."""

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
        """Never reached."""


failure_handling = FailureHandling


class Attempt(Nested["Attempt"]):
    """One run of what may be tried again.

    Attributes:
        number: which one, from 1.
        parameters: what it is to use.
        failures: those of the attempts before it.
        used: whether its body has been run.
    """

    def __init__(self, attempts: _Attempts, number: int, parameters: Parameters, failures: list[BaseException]) -> None:
        """Makes an attempt.

        Args:
            attempts: the row of attempts that it is one of.
            number: which one.
            parameters: what it is to use.
            failures: those of the attempts before it.
        """
        super().__init__("failure_handling")
        self.number = number
        self.parameters = parameters
        self.failures = tuple(failures)
        self.used = False
        self._attempts = attempts

    def __getitem__(self, name: str) -> Result:
        """A parameter."""
        return self.parameters[name]

    def _opened(self) -> AbstractContextManager[Attempt]:
        if self.used:
            raise UsageError(f"attempt {self.number} has been made already; the loop gives the next one")
        self.used = True
        return _Run(self, self._attempts)


class _Run:
    """The body of an attempt."""

    def __init__(self, attempt: Attempt, attempts: _Attempts) -> None:
        self._attempt = attempt
        self._attempts = attempts
        self._span: Span | None = None
        self._exits = ExitStack()

    def __enter__(self) -> Attempt:
        made = self._attempt
        try:
            with ExitStack() as entering:
                entering.enter_context(self._attempts.entered())
                self._span = Span("attempt", f"attempt {made.number}", parameters=made.parameters, attempt=made.number)
                entering.enter_context(self._span)
                token = _attempt.set(made)
                entering.callback(lambda: _attempt.reset(token))
                self._exits = entering.pop_all()
        except BaseException as stopped:
            self._attempts.finish(stopped)
            raise
        return made

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        handled = error
        changed: Parameters | None = None
        if isinstance(error, Retry) and error.attempt is self._attempt:
            handled, changed = error.error or error, error.changed
        with Uninterrupted():  # an exit stack that is broken off forgets what it was about to end
            if self._span is not None:
                self._span.finish(handled)
            self._exits.close()
        return self._attempts.ended(error, handled, changed)


class _Attempts:
    """A row of attempts at one thing."""

    def __init__(self, handling: FailureHandling) -> None:
        self.over = False
        self._handling = handling
        self._parameters = handling.parameters
        self._failures: list[BaseException] = []
        self._span: Span | None = None
        self._number = 0

    def following(self) -> Attempt:
        """The next attempt."""
        self._number += 1
        return Attempt(self, self._number, self._parameters, self._failures)

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Runs its block as part of this row, whose node of the task tree begins with the first attempt."""
        with alone():
            if self._span is None:
                self._span = Span("failure-handling", "failure-handling", parameters=self._handling.told)
                self._span.start()
            with self._span.entered():
                yield

    def ended(self, error: BaseException | None, handled: BaseException | None, changed: Parameters | None) -> bool:
        """Takes the end of an attempt.

        Args:
            error: what came out of its body.
            handled: what it failed with; another one than ``error`` where the body said ``retry``.
            changed: parameters that the next attempt is to have; None if the body didn't say ``retry``.

        Returns:
            Whether there is to be another one; else the error goes on.

        Raises:
            PlanFailure: the last failure, when the retries are used up.
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
            except BaseException as wrong:  # noqa: BLE001  raised below
                final = chained(wrong, [final])
            else:
                self._failures.append(last)
                self._parameters = {**self._parameters, **changed}
                return True
        self.finish(final)
        if final is not error:
            raise_unchanged(final)
        return False

    def close(self) -> None:
        """Ends the row if the plan has left it between two attempts; says so if the last of them failed."""
        if not self.over:
            last = self._failures[-1] if self._failures else None
            self.finish(last)
            if last is not None and not _told_to_stop():
                told = f"the loop was left after attempt {self._number} had failed: {told_error(last)}"
                warnings.warn_explicit(told, FailureLeft, *plan_line())

    def finish(self, error: BaseException | None) -> None:
        """Ends the row.

        Args:
            error: what it failed with; None if an attempt succeeded.
        """
        self.over = True
        if self._span is not None:
            self._span.finish(error)


def _failure_type(kind: type[PlanFailure]) -> type[PlanFailure]:
    if not (isinstance(kind, type) and issubclass(kind, PlanFailure)):
        raise BadArgument("kind", kind, "a type of plan failures; nothing else is tried again")
    return kind


def _told_to_stop() -> bool:
    scope = current_scope()
    return scope is not None and scope.cancelled
