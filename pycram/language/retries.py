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
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from pycram.foundation.failures import BadArgument, PlanFailure, UsageError
from pycram.language.actions import run
from pycram.language.attempts import Attempts, Parameters, is_cancelled
from pycram.language.failures import leaves_uncleaned

if TYPE_CHECKING:
    from typing import Self

    from pycram.language.attempts import Attempt

Result: TypeAlias = Any
#: Gets a failure, does something about it, and may give parameters that the next attempt is to have.
Recovery: TypeAlias = Callable[[Any], "Parameters | None"]


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
    def fields(self) -> dict[str, object]:
        """The parameters of its node of the task tree."""
        kinds = [kind.__name__ for kind in self.kinds]
        return {"retries": self.retries} | ({} if kinds == ["PlanFailure"] else {"kinds": kinds})

    def handles(self, error: BaseException | None) -> bool:
        """Whether there is to be another attempt after an error, if one is left.

        None after a cleaning up that failed because the handling itself is cancelled: being stopped again would
        hide it.
        """
        hidden = error is not None and is_cancelled() and leaves_uncleaned(error)
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
        attempts = Attempts(self)
        try:
            while not attempts.over:
                attempt = attempts.following()
                yield attempt
                if not attempt.used:
                    raise UsageError("the body of `for attempt in failure_handling(5):` has to be `with attempt:`")
        finally:
            attempts.close()

    def run(self, action: Callable[..., Result], *args: object, **kwargs: object) -> Result:
        """Calls a function until it gets through, and returns what it returned.

        An attempt's parameters go before its named arguments.

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


def _failure_type(kind: type[PlanFailure]) -> type[PlanFailure]:
    if not (isinstance(kind, type) and issubclass(kind, PlanFailure)):
        raise BadArgument("kind", kind, "a type of plan failures; nothing else is tried again")
    return kind
