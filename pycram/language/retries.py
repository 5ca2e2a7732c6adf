"""Failure handling: retries after plan failures, with the same or other parameters (thesis 3.5.3).

In CRAM, ``with-failure-handling`` runs its body again when the body says ``retry``. Python runs the body of a ``with``
statement once, so a loop goes around it::

    for attempt in failure_handling(5, arm="left"):
        with attempt:
            pick_up(milk, attempt["arm"])

runs the body until it succeeds, at most six times: once, and five retries. Then the last failure is raised, with the
earlier ones in its context. Recoveries between two attempts depend on the type of failure::

    handling = failure_handling(5).on(Unreachable, lambda failure: {"arm": "right"}).on(InCollision, step_back)

or stand in the body itself, where ``retry`` ends the attempt as in CRAM::

        with attempt:
            try:
                pick_up(milk, attempt["arm"])
            except Unreachable:
                retry(arm="right")

For a function: ``failure_handling(5).run(pick_up, milk)``, or ``@failure_handling(5)`` before its definition. Only plan
failures are retried. In the body of an attempt actions run in order.

Code after ``with attempt`` in the loop also runs after failed attempts. Leaving the loop there, by ``break`` or
``return``, drops an unhandled failure: Python lets nothing be raised then, so :class:`FailureLeft` warns of it. To give
up, raise something or handle the failure inside of ``with attempt``.
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
#: Called with a failure before the next attempt; may return changed parameters for it.
Recovery: TypeAlias = Callable[[Any], "Parameters | None"]


class FailureHandling:
    """How often, and after which failures, code is tried again; reusable, also concurrently.

    Args:
        retries: From 0 up; with 5, there are up to 6 attempts.
        kinds: The types of failures to retry after; all plan failures by default.
        parameters: Parameters of the attempts, until a recovery or ``retry`` changes them.

    Raises:
        BadArgument: Retries below 0, or a type that isn't one of plan failures.
    """

    def __init__(self, retries: int, *kinds: type[PlanFailure], **parameters: object) -> None:
        if isinstance(retries, bool) or not isinstance(retries, int) or retries < 0:
            raise BadArgument("retries", retries, "a whole number from 0 up")
        self.retries = retries
        self.parameters: Parameters = parameters
        self.kinds = tuple(_failure_type(kind) for kind in kinds) or (PlanFailure,)
        self._recoveries: list[tuple[type[PlanFailure], Recovery]] = []

    def on(self, kind: type[PlanFailure], recovery: Recovery) -> Self:
        """Add a recovery, called with failures of a type before the next attempt; return this very handling.

        The first that matches a failure counts. It may return parameters for the next attempt. What it raises ends the
        handling.
        """
        self._recoveries.append((_failure_type(kind), recovery))
        return self

    @property
    def fields(self) -> dict[str, object]:
        """The parameters of its node of the task tree."""
        kinds = [kind.__name__ for kind in self.kinds]
        return {"retries": self.retries} | ({} if kinds == ["PlanFailure"] else {"kinds": kinds})

    def handles(self, error: BaseException | None) -> bool:
        """Whether to retry after an error.

        Not after a failed cleanup if the handling itself is cancelled: the next attempt's cancellation would hide it.
        """
        hidden = error is not None and is_cancelled() and leaves_uncleaned(error)
        return isinstance(error, self.kinds) and not hidden

    def recover(self, failure: BaseException) -> Parameters:
        """Run the recovery of a failure, and return the changed parameters.

        Raises:
            BadArgument: The recovery returned something else.
        """
        for kind, recovery in self._recoveries:
            if isinstance(failure, kind):
                changed = recovery(failure)
                if changed is not None and not isinstance(changed, Mapping):
                    raise BadArgument("result of the recovery", changed, "parameters by name, or None")
                return changed or {}
        return {}

    def __iter__(self) -> Iterator[Attempt]:
        """Yield attempts until one succeeds; each is for a ``with`` statement."""
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
        """Call a function until it succeeds, and return its result, or raise its last failure.

        An attempt's parameters override the named arguments.
        """
        result: Result = None
        for attempt in self:
            with attempt:
                result = run(action, *args, **{**kwargs, **attempt.parameters})
        return result

    def __call__(self, function: Callable[..., Result]) -> Callable[..., Result]:
        """Decorate a function so that it handles its failures itself."""

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
