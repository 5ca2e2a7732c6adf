"""The record types, their topics, and how users' values stand in them.

``proto/log.proto`` is the only definition; this module names its messages for Python and turns values (slots, answers,
results) into the JSON text that the records carry. Whatever has a method ``__record__`` says with it how it stands in a
record: it returns None, a bool, number, string, list or dict.
"""

from __future__ import annotations

import json
import math
import traceback
from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias, runtime_checkable

from recorder.records import log_pb2
from recorder.records.log_pb2 import (
    Argument,
    Asset,
    AttachBody,
    Attachment,
    BodyState,
    CloseWorld,
    DetachBody,
    Effect,
    Event,
    Failure,
    Fluent,
    HandlerCall,
    Keyframe,
    LoadBody,
    MoveBody,
    MoveJoints,
    Mutation,
    OpenWorld,
    Picture,
    Query,
    RemoveBody,
    Reset,
    Run,
    Sample,
    SetColor,
    SetGravity,
    SetRealtime,
    SetRobot,
    Simulate,
    SourceLine,
    Task,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = [
    "STEPS_PER_SECOND",
    "TOPICS",
    "Argument",
    "Asset",
    "AttachBody",
    "Attachment",
    "BodyState",
    "CloseWorld",
    "DetachBody",
    "Effect",
    "Event",
    "Failure",
    "Fluent",
    "HandlerCall",
    "Keyframe",
    "LoadBody",
    "MoveBody",
    "MoveJoints",
    "Mutation",
    "OpenWorld",
    "Picture",
    "Query",
    "Record",
    "RemoveBody",
    "Reset",
    "Run",
    "Sample",
    "SetColor",
    "SetGravity",
    "SetRealtime",
    "SetRobot",
    "Simulate",
    "SourceLine",
    "Task",
    "arguments",
    "failure",
    "format_error",
    "format_failure",
    "message",
    "to_json",
]

Record: TypeAlias = Run | Task | Mutation | Event | Fluent | Query | Keyframe

TOPICS: Mapping[type[Record], str] = {
    Run: "/run",
    Task: "/task",
    Mutation: "/mutation",
    Event: "/event",
    Fluent: "/fluent",
    Query: "/query",
    Keyframe: "/keyframe",
}
"""The MCAP topic of each record type; one type each."""

STEPS_PER_SECOND: Final = 240
"""Of simulated time, which a record's ``sim_step`` counts; every world is simulated at this pace."""

FILE_DESCRIPTOR = log_pb2.DESCRIPTOR


@runtime_checkable
class _Array(Protocol):
    """NumPy's arrays and scalars, told by what they can: whoever only reads records need not wait for numpy."""

    def tolist(self) -> object:
        """Returns plain numbers, nested as the array is."""


def _plain(value: object) -> object:
    exact = _EXACT.get(type(value))
    if exact is not None:
        return exact(value)
    told = getattr(type(value), "__record__", None)  # by its real type: what stands for a result says that it is one
    if told is not None:
        return _plain(told(value))
    for kinds, plain in _PLAIN:
        if isinstance(value, kinds):
            return plain(value)
    module, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    return {"callable": f"{module}.{name}"} if module and name else {"repr": repr(value)}


def _finite(value: float) -> object:
    return float(value) if math.isfinite(value) else {"float": repr(float(value))}


def _mapping(value: Mapping[object, object]) -> object:
    return {str(key): _plain(item) for key, item in value.items()}


def _sequence(value: Iterable[object]) -> object:
    return [_plain(item) for item in value]


# Python's own types, by which most values are known at once
_EXACT: Mapping[type, Callable[[Any], object]] = {
    type(None): lambda value: value,
    bool: bool,
    str: str,
    int: int,
    float: _finite,
    dict: _mapping,
    list: _sequence,
    tuple: _sequence,
}

_PLAIN: tuple[tuple[Any, Callable[[Any], object]], ...] = (
    (str, lambda value: value),
    (int, int),
    (float, _finite),
    (Mapping, _mapping),
    (AbstractSet, lambda value: sorted((_plain(item) for item in value), key=repr)),
    ((list, tuple), _sequence),
    (_Array, lambda value: _plain(value.tolist())),
)


def to_json(value: object) -> str:
    """Any value as one line of JSON; floats keep all their bits.

    Args:
        value: what a user gave. Arrays become lists, recordable objects what they say of themselves, anything unknown
            ``{"repr": ...}``, and what can't even be told ``{"untold": type, "because": ...}``: recording never breaks
            a plan.

    Returns:
        JSON text.
    """
    try:
        text = json.dumps(_plain(value), ensure_ascii=False, separators=(",", ":"))
        text.encode()  # a lone surrogate can't be
    except UnicodeEncodeError:
        return json.dumps(_plain(value), separators=(",", ":"))
    except Exception as error:  # noqa: BLE001  the user's own __repr__ and __record__, and lists that hold themselves
        return json.dumps({"untold": type(value).__qualname__, "because": format_error(error)})
    return text


def arguments(values: Mapping[str, object] | Iterable[tuple[str, object]]) -> list[Argument]:
    """Named values as a record carries them.

    Args:
        values: values by name.

    Returns:
        One ``Argument`` each, in the given order.
    """
    pairs = values.items() if isinstance(values, Mapping) else values
    return [Argument(name=str(name), json=to_json(value)) for name, value in pairs]


def message(error: BaseException) -> str:
    """What an exception says, whatever its own ``__str__`` does.

    Args:
        error: the exception.
    """
    try:
        return str(error)
    except Exception as untold:  # noqa: BLE001  the error's own __str__
        return f"<it can't be told: {type(untold).__qualname__}>"


def format_error(error: BaseException) -> str:
    """An exception by its type, and its message if it has one.

    Args:
        error: the exception.
    """
    said = message(error)
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def failure(error: BaseException, *, trace: bool = True) -> Failure:
    """An exception as a record carries it.

    Args:
        error: what was raised; its fields are its ``data`` mapping where it has one.
        trace: whether with its traceback, which takes the most time.

    Returns:
        Type, message, data and traceback.
    """
    data = getattr(error, "data", None)
    lines: list[str] = []
    if trace:
        with suppress(Exception):  # of the error's own methods
            lines = traceback.format_exception(error)
    return Failure(
        type=type(error).__qualname__,
        message=_sound(message(error)),
        data=arguments(data) if isinstance(data, Mapping) else [],
        traceback=_sound("".join(lines)),
    )


def format_failure(failure: Failure) -> str:
    """A failure by its type, and its message if it has one.

    Args:
        failure: as a record carries it.
    """
    return f"{failure.type}: {failure.message}" if failure.message else failure.type


def _sound(text: str) -> str:
    """A text that a file can hold: lone surrogates as escapes."""
    return text.encode("utf-8", "backslashreplace").decode()
