"""Refusals: calls that PyCRAM rejects are recorded with their error, even if the plan catches the error.

A refusal is recorded once, as the call that the plan made: for nested PyCRAM calls the outermost is recorded; a call
inside a plan's handler, resolver or query is recorded itself.
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

_RECORDED: Final = "_is_on_record"  # an attribute of errors, which isn't part of their data


def refusing(
    subject: str = "", kinds: type[BaseException] = UsageError, *, name: str = ""
) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a function so that its refusals are recorded.

    Args:
        subject: Name of its argument ``self`` in records ("object", "world", ...); "" for the parameter's name.
        kinds: The errors that are refusals; a call with wrong arguments is a refusal, too.
        name: Name of the function in records; its own name by default.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(function)
        def ask(*args: P.args, **kwargs: P.kwargs) -> T:
            try:
                return function(*args, **kwargs)
            except (kinds, TypeError) as error:
                asked_wrongly = isinstance(error, kinds) or _is_of_call(error)
                if asked_wrongly and not is_recorded(error) and not _is_part(sys._getframe(1)):  # noqa: SLF001  like inspect.currentframe()
                    refused(error, name or function.__name__, _arguments(function, subject, args, kwargs))
                raise

        return ask

    return decorate


_ASK: Final = refusing()(refusing).__code__  # the code of all decorated functions


def refusing_methods(subject: str) -> Callable[[Class], Class]:
    """Decorate a class so that refusals of its public methods and its constructor are recorded."""

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
    """Record a rejected call, with the function's name and arguments, and return the error to raise."""
    if journal.recording():
        record = records.Refusal(name=name, arguments=records.arguments(arguments), failure=records.failure(error))
        world, sim_step = _where(arguments.values())
        with suppress(OSError):  # a failing disk must not hide the error; the next record raises the disk's error
            span.emit(record, world=world, sim_step=sim_step)
        mark_recorded(error)
    return error


def mark_recorded(error: BaseException) -> None:
    """Mark an error as recorded, so that the calls around it don't record it as a refusal."""
    BaseException.__setattr__(error, _RECORDED, True)


def is_recorded(error: BaseException) -> bool:
    """Return whether an error is on record."""
    return _RECORDED in vars(error)


def _is_of_call(error: BaseException) -> bool:
    """Return whether Python raised an error at the call of a function, before its first statement."""
    return error.__traceback__ is not None and error.__traceback__.tb_next is None


def _is_part(frame: FrameType | None) -> bool:
    """Return whether a call is part of another decorated call, without code of the plan between them."""
    while frame is not None and not is_plan(frame):
        if frame.f_code is _ASK:
            return True
        frame = frame.f_back
    return False


def _arguments(
    function: Callable[..., object], subject: str, args: tuple[object, ...], kwargs: Mapping[str, object]
) -> dict[str, object]:
    """Return the arguments of a call by name, or by index if they don't fit; without ``self`` of a constructor."""
    try:
        given = dict(inspect.signature(function).bind_partial(*args, **kwargs).arguments)
    except TypeError:
        given = {**{str(index): value for index, value in enumerate(args)}, **kwargs}
    if function.__name__ == "__init__":
        given.pop("self", None)
    return {subject or key if key == "self" else key: value for key, value in given.items()}


def _where(arguments: Iterable[object]) -> tuple[str, int]:
    """Return name and simulated steps of the first argument's world, or of the current world if there is none."""
    for argument in arguments:
        envelope = getattr(type(argument), "_envelope", None)  # its real type: a future imitates another type
        if envelope is not None:
            with suppress(AttributeError):  # its constructor is still running
                name, sim_step = envelope(argument)
                return str(name), int(sim_step)
    return journal.current_world()
