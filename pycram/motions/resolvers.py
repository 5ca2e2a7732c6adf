"""Resolvers: functions that users register, called in order until one answers."""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Generic, TypeVar

from pycram.foundation.failures import BadArgument, UnknownName
from pycram.foundation.names import qualified_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

Function = TypeVar("Function", bound="Callable[..., object]")


class Resolvers(Generic[Function]):
    """Functions in the order in which they were added; iteration goes through a snapshot.

    Args:
        owner: What they resolve, for messages.
    """

    def __init__(self, owner: str) -> None:
        self.owner = owner
        self._lock = threading.Lock()
        self._functions: tuple[Function, ...] = ()

    def append(self, function: Function) -> Function:
        """Add a function at the end, once, and return it; also a decorator.

        Raises:
            BadArgument: It isn't callable.
        """
        if not callable(function):
            raise BadArgument(f"resolver of {self.owner}", function, "a function that takes a designator")
        with self._lock:
            if function not in self._functions:
                self._functions = (*self._functions, function)
        return function

    def remove(self, function: Function) -> None:
        """Remove a function.

        Raises:
            UnknownName: It isn't in the list.
        """
        with self._lock:
            kept = tuple(known for known in self._functions if known != function)
            if len(kept) == len(self._functions):
                raise UnknownName("resolver", qualified_name(function), self.owner, map(qualified_name, kept))
            self._functions = kept

    @contextmanager
    def added(self, function: Function) -> Iterator[Function]:
        """Add a function, not yet in the list, for the ``with`` block."""
        self.append(function)
        try:
            yield function
        finally:
            self.remove(function)

    def __iter__(self) -> Iterator[Function]:
        return iter(self._functions)

    def __len__(self) -> int:
        return len(self._functions)

    def __contains__(self, function: object) -> bool:
        return function in self._functions
