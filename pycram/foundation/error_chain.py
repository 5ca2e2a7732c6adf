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
        if id(other) not in known and _freed(other, known):
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


def _freed(error: BaseException, known: set[int]) -> bool:
    """Parts an error from the known ones if it only came while they were handled; whether it is parted from them now.

    Hanging it behind them would close a circle otherwise.
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
