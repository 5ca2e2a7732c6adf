"""The two families of errors, and what all of them can.

A :class:`PlanFailure` says that the world refused: a plan may catch it and try something else. A :class:`UsageError`
says that the program is wrong: nothing should catch it. Every error keeps its data as attributes, which the recording
stores beside the message. It may be a dataclass, also a frozen one: what Python itself notes on an exception while that
rises (its traceback and context) can be set all the same.
"""

from __future__ import annotations

import functools
from types import MemberDescriptorType
from typing import TYPE_CHECKING, Final
from weakref import WeakSet

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from typing import Self


class PycramError(Exception):
    """Base of everything that PyCRAM raises on purpose."""

    def __new__(cls, *args: object, **kwargs: object) -> Self:
        """Makes an instance that can rise, whatever its class does to assignments."""
        if cls not in _able_to_rise:
            _let_rise(cls)
        return super().__new__(cls, *args, **kwargs)

    @property
    def data(self) -> Mapping[str, object]:
        """The error's fields by name."""
        fields = {slot.__name__: slot.__get__(self) for slot in slots_of(self)}
        return {name: value for name, value in (fields | vars(self)).items() if not name.startswith("_")}


class PlanFailure(PycramError):
    """The world said no; a plan may handle it."""


class UsageError(PycramError):
    """The program is wrong; plans must not handle it."""


def slots_of(error: PycramError) -> Iterator[MemberDescriptorType]:
    """The slots in which an error holds fields, as dataclasses with ``slots=True`` do.

    Args:
        error: the error.
    """
    for base in type(error).__mro__:
        if issubclass(base, PycramError):
            for slot in vars(base).values():
                if isinstance(slot, MemberDescriptorType) and hasattr(error, slot.__name__):
                    yield slot


#: What Python notes on an exception while that rises; context managers do so too, those of contextlib among them.
_NOTED: Final = frozenset({"__cause__", "__context__", "__notes__", "__suppress_context__", "__traceback__"})

_able_to_rise: Final[WeakSet[type[PycramError]]] = WeakSet()


def _let_rise(kind: type[PycramError]) -> None:
    """Lets through what Python notes where a class refuses assignments, as frozen dataclasses do.

    A decorator makes a class so after all that base classes are told of it: it is seen when there is an instance.
    """
    for base in kind.__mro__:
        if issubclass(base, PycramError) and base not in _able_to_rise:
            _able_to_rise.add(base)
            if "__setattr__" in vars(base):
                _let_through(base)


def _let_through(kind: type[PycramError]) -> None:
    assign = kind.__setattr__

    @functools.wraps(assign)
    def note_or_assign(error: PycramError, name: str, value: object) -> None:
        if name in _NOTED:
            BaseException.__setattr__(error, name, value)
        else:
            assign(error, name, value)

    kind.__setattr__ = note_or_assign  # type: ignore[method-assign, assignment]
