"""A context variable's value for the duration of a ``with`` block."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from contextvars import ContextVar, Token

Value = TypeVar("Value")


class Binding(Generic[Value]):
    """Sets a context variable for a ``with`` block; a class, as each branch enters several and generators are slow."""

    __slots__ = ("_token", "_value", "_variable")
    _token: Token[Value]

    def __init__(self, variable: ContextVar[Value], value: Value) -> None:
        self._variable = variable
        self._value = value

    def __enter__(self) -> None:
        self._token = self._variable.set(self._value)

    def __exit__(self, *_: object) -> None:
        self._variable.reset(self._token)
