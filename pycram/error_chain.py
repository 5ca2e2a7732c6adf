"""Errors that happened together: one is raised, the others stay attached to it, so that none vanishes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterable

ErrorType = TypeVar("ErrorType", bound=BaseException)


def chained(error: ErrorType, others: Iterable[BaseException]) -> ErrorType:
    """Hangs errors behind the context of the one that is going to be raised; tracebacks then print all of them.

    Args:
        error: the error to raise.
        others: what happened beside it. Those that its chain holds already are left out.

    Returns:
        The error.
    """
    for other in others:
        last: BaseException = error
        known = {id(last)}
        while (earlier := last.__cause__ or last.__context__) is not None and id(earlier) not in known:
            last = earlier
            known.add(id(last))
        if id(other) not in known and not _leads_to(other, known):
            last.__context__ = other
            last.__suppress_context__ = False
    return error


def raise_unchanged(error: BaseException) -> NoReturn:
    """Raises an error with the context that it has, also while another one is being handled.

    Args:
        error: the error.
    """
    context = error.__context__
    try:
        raise error
    finally:
        error.__context__ = context


def _leads_to(error: BaseException, known: set[int]) -> bool:
    """Whether hanging this error behind the known ones would close a circle."""
    seen: set[int] = set()
    earlier: BaseException | None = error
    while earlier is not None and id(earlier) not in seen:
        if id(earlier) in known:
            return True
        seen.add(id(earlier))
        earlier = earlier.__cause__ or earlier.__context__
    return False
