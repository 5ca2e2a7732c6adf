"""Tracebacks as text, as Python prints them; in a long traceback, a number replaces the middle.

Each task that an error ends records this error with its causes. The text of each line of code is therefore cached.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar
from functools import partial
from itertools import groupby
from operator import attrgetter
from traceback import TracebackException
from types import CodeType, TracebackType
from typing import TYPE_CHECKING, Final, TypeAlias, TypeVar

from recorder import notebook

if TYPE_CHECKING:
    Formatter: TypeAlias = Callable[[BaseException], str]

Value = TypeVar("Value")
Other = TypeVar("Other")

MAX_FRAMES: Final = 32  # the text of an error has at most this many frames, the innermost frames
MAX_ERRORS: Final = 16  # a traceback's text has at most this many errors, from both ends of the chain

_FIRST: Final = 4  # number of errors that a text has from the chain's beginning, which contains the root causes
_MAX_EXPLORED: Final = 64  # maximum number of related errors that are printed with an error
_REPEATED: Final = 3  # Number of times that Python prints a repeated line, before the number of repetitions
_MAX_CACHED: Final = 4096
_CAUSE: Final = "\nThe above exception was the direct cause of the following exception:\n\n"
TITLE: Final = "Traceback (most recent call last):\n"
CONTEXT: Final = "\nDuring handling of the above exception, another exception occurred:\n\n"
_PLACE: Final = attrgetter("co_filename", "co_name")
_SPECIAL: Final = (SyntaxError, ImportError, NameError, AttributeError)  # Python adds details to their messages

#: Replaces :func:`format_traceback` in formatting tracebacks, also within messages; None to print all frames.
formatter: Final[ContextVar[Formatter | None]] = ContextVar("recorder_tracebacks", default=None)

# cached texts of frames, by the address of the code; the values keep the code alive
_texts: Final[dict[tuple[int, int, int], tuple[CodeType, str]]] = {}


def format_traceback(error: BaseException, *, frames: int = MAX_FRAMES, errors: int = MAX_ERRORS) -> str:
    """Return the text of an error and its causes: ``frames`` innermost frames of each error, and ``errors`` errors."""
    if (own := formatter.get()) is not None:
        return own(error)
    links = chain(error)
    left_out = len(links) - errors
    parts = [f"{link}{part(each, frames)}" for link, each in links[:_FIRST]]
    if left_out > 0:
        del links[_FIRST : _FIRST + left_out]
    for link, each in links[_FIRST:]:
        count = f"  [{left_out} errors are left out; see the tasks that they ended]\n\n" if left_out > 0 else ""
        parts.append(f"{link}{count}{part(each, frames)}")
        left_out = 0
    return notebook.with_cells("".join(parts))


def chain(error: BaseException) -> list[tuple[str, BaseException]]:
    """Return pairs of a text and an error, the root cause first; the text links the error to the previous error.

    A group of errors prints its own causes.
    """
    links: list[tuple[str, BaseException]] = []
    seen = {id(error)}
    while not _is_small_group(error):
        cause, context = error.__cause__, error.__context__
        if cause is not None and id(cause) not in seen:
            link, earlier = _CAUSE, cause
        elif context is not None and id(context) not in seen and not error.__suppress_context__:
            link, earlier = CONTEXT, context
        else:
            break
        links.append((link, error))
        seen.add(id(earlier))
        error = earlier
    links.append(("", error))
    return links[::-1]


def part(error: BaseException, frames: int = MAX_FRAMES) -> str:
    """Return the text of an error without its causes."""
    if _is_small_group(error):
        return "".join(traceback.format_exception(type(error), error, error.__traceback__, limit=-frames))
    shown = entries(error.__traceback__)[-frames:]
    return "".join((TITLE if shown else "", *stack(shown), *message(error)))


def _is_small_group(error: BaseException) -> bool:
    return isinstance(error, BaseExceptionGroup) and _is_quickly_printed(error)


def _is_quickly_printed(error: BaseException) -> bool:
    """Return whether an error has few related errors. For nested groups, Python's visits grow quadratically."""
    errors = [error]
    for each in errors:
        members = each.exceptions if isinstance(each, BaseExceptionGroup) else ()
        errors += [other for other in (each.__cause__, each.__context__, *members) if other is not None]
        if len(errors) > _MAX_EXPLORED:
            return False
    return True


def entries(trace: TracebackType | None) -> list[TracebackType]:
    """Return the entries of a traceback, the outermost frame first."""
    found = []
    while trace is not None:
        found.append(trace)
        trace = trace.tb_next
    return found


def stack(shown: Iterable[TracebackType]) -> Iterator[str]:
    """Yield the texts of entries."""
    for _, group in groupby(shown, lambda each: (*_PLACE(each.tb_frame.f_code), each.tb_lineno)):
        same = list(group)
        yield from map(_frame, same[:_REPEATED])
        if (more := len(same) - _REPEATED) > 0:
            yield f"  [Previous line repeated {more} more time{'s' if more > 1 else ''}]\n"


def _frame(entry: TracebackType) -> str:
    """Return the text of a traceback's frame. Without the cache, Python would look up and parse the line each time."""
    code = entry.tb_frame.f_code
    key = id(code), entry.tb_lasti, entry.tb_lineno
    known = _texts.get(key)
    if known is None:
        if len(_texts) >= _MAX_CACHED:
            _texts.clear()
        known = _texts[key] = code, "".join(traceback.format_tb(entry, limit=1))
    return known[1]


def message(error: BaseException) -> Iterator[str]:
    """Yield the text of an error without its traceback."""
    kind, notes = type(error), getattr(error, "__notes__", None)
    if (isinstance(error, _SPECIAL) or not isinstance(notes, list | None)) and _is_quickly_printed(error):
        yield from TracebackException(kind, error, error.__traceback__, limit=0).format_exception_only()
        return
    module = "" if kind.__module__ in {"builtins", "__main__"} else f"{kind.__module__}."
    name, text = f"{module}{kind.__qualname__}", result_or(lambda: str(error), lambda _: "<exception str() failed>")
    yield f"{name}: {text}\n" if text else f"{name}\n"
    for note in notes if isinstance(notes, list) else ():
        yield from (f"{line}\n" for line in result_or(partial(str, note), lambda _: "<note str() failed>").split("\n"))


def result_or(call: Callable[[], Value], otherwise: Callable[[Exception], Other]) -> Value | Other:
    """Return the result of a user's method. If the method raises an error, return ``otherwise(error)``."""
    try:
        return call()
    except Exception as error:  # noqa: BLE001  a method of the user may raise any error
        return otherwise(error)
