"""Refusals: calls that PyCRAM rejects are recorded with their error, even if the plan catches the error.

A refusal is recorded once: as the call that the plan made. Calls within this call are recorded only if a handler,
resolver or query of the plan makes them.
"""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from types import FrameType, FunctionType
from typing import Final, ParamSpec, TypeVar

from pycram.foundation.errors import UsageError
from pycram.foundation.forcing import SKIPPED, decider, forced
from recorder import records
from recorder.tracing import journal, span
from recorder.tracing.call_stack import is_plan

P = ParamSpec("P")
T = TypeVar("T")
Class = TypeVar("Class", bound=type)
Error = TypeVar("Error", bound=BaseException)

_RECORDED: Final = "_is_on_record"  # attribute that marks a recorded error, and isn't part of the error's data


def refusing(subject: str = "", *, name: str = "") -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a function so that its refusals are recorded, also refusals of calls with wrong arguments.

    In records, ``subject`` replaces the name "self" of the first argument, and ``name`` the function's own name.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(function)
        def ask(*args: P.args, **kwargs: P.kwargs) -> T:
            if decider() is not None:  # a recording guides the run
                given = _arguments(function, subject, args, kwargs)
                if forced(f"call {name or function.__name__}", given) == SKIPPED:
                    return None  # type: ignore[return-value]  # only calls without a result are skipped
            try:
                return function(*args, **kwargs)
            except (UsageError, TypeError) as error:
                # without a next frame, Python raised the error at the call itself, before the first statement
                at_call = error.__traceback__ is not None and error.__traceback__.tb_next is None
                asked_wrongly = isinstance(error, UsageError) or at_call
                if asked_wrongly and _RECORDED not in vars(error) and not _is_part(sys._getframe(1)):  # noqa: SLF001  like inspect.currentframe()
                    refused(error, name or function.__name__, _arguments(function, subject, args, kwargs))
                raise

        return ask

    return decorate


_ASK: Final = refusing()(refusing).__code__  # all decorated functions have this same code


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
    """Record a rejected call with the name and the arguments of its function; return the error."""
    if journal.recording():
        record = records.Refusal(name=name, arguments=records.arguments(arguments), failure=records.failure(error))
        world, sim_step = _where(arguments.values())
        with suppress(OSError):  # an error of the disk must not hide this error; the next record raises it
            span.emit(record, world=world, sim_step=sim_step)
        mark_recorded(error)
    return error


def mark_recorded(error: BaseException) -> None:
    """Mark an error as recorded, so that outer calls don't record the error again."""
    BaseException.__setattr__(error, _RECORDED, True)


def _is_part(frame: FrameType | None) -> bool:
    """Return whether a decorated function made this call, without code of the plan between both calls."""
    while frame is not None and not is_plan(frame):
        if frame.f_code is _ASK:
            return True
        frame = frame.f_back
    return False


def _arguments(
    function: Callable[..., object], subject: str, args: tuple[object, ...], kwargs: Mapping[str, object]
) -> dict[str, object]:
    try:
        given = dict(inspect.signature(function).bind_partial(*args, **kwargs).arguments)
    except TypeError:
        given = {**{str(index): value for index, value in enumerate(args)}, **kwargs}
    if function.__name__ == "__init__":
        given.pop("self", None)
    return {subject or key if key == "self" else key: value for key, value in given.items()}


def _where(arguments: Iterable[object]) -> tuple[str, int]:
    """Return the name and the simulated steps of the first argument's world, else of the current world."""
    for argument in arguments:
        envelope = getattr(type(argument), "_envelope", None)  # type(): a future imitates its result's class
        if envelope is not None:
            with suppress(AttributeError):  # the argument's constructor hasn't finished
                name, sim_step = envelope(argument)
                return str(name), int(sim_step)
    return journal.current_world()
