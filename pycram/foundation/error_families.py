"""The two families of errors, and what all of them have in common.

A :class:`PlanFailure` says that the world refused: a plan may catch it and try something else. A :class:`UsageError`
says that the program is wrong: nothing should catch it. Every error keeps its data as attributes, which the recording
stores beside the message. It may be a dataclass, also a frozen one: the attributes that Python sets while an exception
propagates (traceback, context) can be set all the same.
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
        """Make an instance that can be raised even if its class refuses assignments."""
        if cls not in _raisable:
            _make_raisable(cls)
        return super().__new__(cls, *args, **kwargs)

    @property
    def data(self) -> Mapping[str, object]:
        """The error's fields by name."""
        fields = {slot.__name__: slot.__get__(self) for slot in slots_of(self)}
        return {name: value for name, value in (fields | vars(self)).items() if not name.startswith("_")}

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle and copy it with its fields: its message alone isn't what its class makes one of."""
        slots = {slot.__name__: slot.__get__(self) for slot in slots_of(self)}
        return _restored, (type(self), self.args, slots, dict(vars(self)))


class PlanFailure(PycramError):
    """The world said no; a plan may handle it."""


class UsageError(PycramError):
    """The program is wrong; plans must not handle it."""


def _restored(
    kind: type[PycramError], args: tuple[object, ...], slots: Mapping[str, object], fields: Mapping[str, object]
) -> PycramError:
    """Make an error again that was pickled."""
    error = kind.__new__(kind, *args)
    vars(error).update(fields)  # not by assignments: its class may refuse them
    for name, value in slots.items():
        getattr(kind, name).__set__(error, value)
    return error


def slots_of(error: PycramError) -> Iterator[MemberDescriptorType]:
    """Yield the slots in which an error holds fields, as dataclasses with ``slots=True`` do."""
    for base in type(error).__mro__:
        if issubclass(base, PycramError):
            for slot in vars(base).values():
                if isinstance(slot, MemberDescriptorType) and hasattr(error, slot.__name__):
                    yield slot


#: What Python sets on an exception that propagates; context managers, those of contextlib among them, do so too.
_SET_BY_PYTHON: Final = frozenset({"__cause__", "__context__", "__notes__", "__suppress_context__", "__traceback__"})

_raisable: Final[WeakSet[type[PycramError]]] = WeakSet()


def _make_raisable(kind: type[PycramError]) -> None:
    """Allow what Python sets on exceptions where a class refuses assignments, as frozen dataclasses do.

    A dataclass gets its ``__setattr__`` only after ``__init_subclass__`` has run: hence with the first instance.
    """
    for base in kind.__mro__:
        if issubclass(base, PycramError) and base not in _raisable:
            _raisable.add(base)
            if "__setattr__" in vars(base):
                _allow_python(base)


def _allow_python(kind: type[PycramError]) -> None:
    assign = kind.__setattr__

    @functools.wraps(assign)
    def set_or_assign(error: PycramError, name: str, value: object) -> None:
        if name in _SET_BY_PYTHON:
            BaseException.__setattr__(error, name, value)
        else:
            assign(error, name, value)

    kind.__setattr__ = set_or_assign  # type: ignore[method-assign, assignment]  # wraps its own
