"""Errors that happened together: one is raised with the others in its context chain, so that none is lost."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

ErrorType = TypeVar("ErrorType", bound=BaseException)


def chained(error: ErrorType, others: Iterable[BaseException]) -> ErrorType:
    """Append errors to the context chain of one that is going to be raised; tracebacks then print all of them.

    Args:
        error: The error to raise, which is returned.
        others: Errors that happened beside it; those that its chain holds already are left out.
    """
    for other in others:
        last: BaseException = error
        known = {id(last)}
        while (earlier := last.__cause__ or last.__context__) is not None and id(earlier) not in known:
            last = earlier
            known.add(id(last))
        if id(other) not in known and _detached(other, known):
            last.__context__ = other
            last.__suppress_context__ = False
    return error


def call_all(calls: Iterable[Callable[[], object]]) -> list[Exception]:
    """Make all calls, also after one that raised, and return the errors."""
    errors = []
    for call in calls:
        try:
            call()
        except Exception as error:  # noqa: BLE001  the caller raises it when all are made
            errors.append(error)
    return errors


def raise_unchanged(error: BaseException) -> NoReturn:
    """Raise an error with the context that it has, also while another one is being handled."""
    context = error.__context__
    try:
        raise error
    finally:
        error.__context__ = context


def _detached(error: BaseException, known: set[int]) -> bool:
    """Cut an error's context chain before the known errors, as appending it to them would close a circle.

    Returns:
        False if it was raised explicitly from one of them, and so can't be cut off.
    """
    seen: set[int] = set()
    later = error
    while id(later) not in seen:
        seen.add(id(later))
        earlier = later.__cause__ or later.__context__
        if earlier is None:
            break
        if id(earlier) in known:
            if later.__cause__ is not None:
                return False
            later.__context__ = None
            break
        later = earlier
    return True
