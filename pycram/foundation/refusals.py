"""Refusals: what was asked and refused goes on record with its error, also where the plan catches that.

A refusal is recorded once, as what the plan itself called: of calls within calls of PyCRAM the outermost, of a call in
the plan's own handler, resolver or query that one.
"""

from __future__ import annotations

import functools
import inspect
import sys
from contextlib import suppress
from types import FunctionType
from typing import TYPE_CHECKING, Final, ParamSpec, TypeVar

from pycram.foundation.errors import UsageError
from recorder import records
from recorder.tracing import journal, span
from recorder.tracing.call_stack import is_plan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from types import FrameType

P = ParamSpec("P")
T = TypeVar("T")
Class = TypeVar("Class", bound=type)
Error = TypeVar("Error", bound=BaseException)

_RECORDED: Final = "_is_on_record"  # an attribute of errors; their data leaves it out


def refusing(
    subject: str = "", kinds: type[BaseException] = UsageError, *, name: str = ""
) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a function so that what it refuses goes on record.

    Args:
        subject: What records call its first argument ("object", "world", ...); "" to call it by its name.
        kinds: The errors that are refusals; a call with arguments that the function doesn't take is one, too.
        name: What records call the function; its own name by default.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(function)
        def ask(*args: P.args, **kwargs: P.kwargs) -> T:
            try:
                return function(*args, **kwargs)
            except (kinds, TypeError) as error:
                asked_wrongly = isinstance(error, kinds) or _is_of_call(error)
                if asked_wrongly and not is_recorded(error) and not _is_part(sys._getframe(1)):  # noqa: SLF001  as inspect.currentframe() has it
                    refused(error, name or function.__name__, _arguments(function, subject, args, kwargs))
                raise

        return ask

    return decorate


_ASK: Final = refusing()(refusing).__code__  # of all decorated functions


def refusing_methods(subject: str) -> Callable[[Class], Class]:
    """Decorate a class so that what its public methods and its constructor refuse goes on record."""

    def decorate(kind: Class) -> Class:
        for name, member in list(vars(kind).items()):
            if name.startswith("_") and name != "__init__":
                continue
            if isinstance(member, FunctionType):
                called = kind.__name__ if name == "__init__" else name
                setattr(kind, name, refusing(subject, name=called)(member))
            elif isinstance(member, staticmethod):
                setattr(kind, name, staticmethod(refusing(subject)(member.__func__)))
        return kind

    return decorate


def refused(error: Error, name: str, arguments: Mapping[str, object]) -> Error:
    """Record what was asked for, and return the error to raise.

    Args:
        error: Why not.
        name: What was called.
        arguments: With what.
    """
    if journal.recording():
        record = records.Refusal(name=name, arguments=records.arguments(arguments), failure=records.failure(error))
        world, sim_step = _where(arguments.values())
        with suppress(OSError):  # a failing disk must not hide why; the next record raises it
            span.emit(record, world=world, sim_step=sim_step)
        mark_recorded(error)
    return error


def mark_recorded(error: BaseException) -> None:
    """Keep an error from being recorded as a refusal by the calls that it still passes through."""
    BaseException.__setattr__(error, _RECORDED, True)


def is_recorded(error: BaseException) -> bool:
    """Return whether it is on record already."""
    return _RECORDED in vars(error)


def _is_of_call(error: BaseException) -> bool:
    """Return whether Python raised it as the function was called, before anything in it ran."""
    return error.__traceback__ is not None and error.__traceback__.tb_next is None


def _is_part(frame: FrameType | None) -> bool:
    """Return whether a call is part of another decorated one, without the plan's own code between them."""
    while frame is not None and not is_plan(frame):
        if frame.f_code is _ASK:
            return True
        frame = frame.f_back
    return False


def _arguments(
    function: Callable[..., object], subject: str, args: tuple[object, ...], kwargs: Mapping[str, object]
) -> dict[str, object]:
    """Return what a function was called with by name, as far as it takes it; not the object that it makes."""
    try:
        given = dict(inspect.signature(function).bind_partial(*args, **kwargs).arguments)
    except TypeError:
        given = {**{str(index): value for index, value in enumerate(args)}, **kwargs}
    if function.__name__ == "__init__":
        given.pop("self", None)
    return {subject or key if key == "self" else key: value for key, value in given.items()}


def _where(arguments: Iterable[object]) -> tuple[str, int]:
    """Return name and simulated steps of the world of the first argument that is in one, else of the current world."""
    for argument in arguments:
        envelope = getattr(type(argument), "_envelope", None)  # of its real type: a lazy result imitates another
        if envelope is not None:
            with suppress(AttributeError):  # it is only being made
                name, sim_step = envelope(argument)
                return str(name), int(sim_step)
    return journal.current_world()
