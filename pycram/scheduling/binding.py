"""A value that a context variable has while a block runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from contextvars import ContextVar, Token

Value = TypeVar("Value")


class Binding(Generic[Value]):
    """Gives a variable its value for a ``with`` block; each branch enters several, so it is no generator."""

    __slots__ = ("_token", "_value", "_variable")
    _token: Token[Value]

    def __init__(self, variable: ContextVar[Value], value: Value) -> None:
        self._variable = variable
        self._value = value

    def __enter__(self) -> None:
        """From now on it holds."""
        self._token = self._variable.set(self._value)

    def __exit__(self, *_: object) -> None:
        """The variable has again what it had before."""
        self._variable.reset(self._token)
