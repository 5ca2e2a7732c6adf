"""Actions: functions of the plan that act when they are called.

Calling a function with ``async`` or ``yield`` in it only makes a coroutine or a generator. As an action it would count
as a success without having run, so it is refused. A plain function may well return a generator: it has run.
"""

from __future__ import annotations

from functools import partial
from inspect import GEN_CREATED, getgeneratorstate
from types import AsyncGeneratorType, CoroutineType, FunctionType, GeneratorType, MethodType
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

from pycram.foundation.failures import BadArgument

if TYPE_CHECKING:
    from collections.abc import Callable

#: Whatever an action's process module or function returns.
Result: TypeAlias = Any
Function = TypeVar("Function", bound="Callable[..., Result]")

_LAZY: Final = "__pycram_lazy__"
_NOT_BEGUN: Final = "a plain function; one with `yield` does nothing before its values are taken: `lambda: [*f()]` does"


def name_of(action: Callable[..., Result]) -> str:
    """Return a function's name, without its module and without the function that it is defined in."""
    name = getattr(action, "__qualname__", None) or type(action).__qualname__
    return str(name).rpartition("<locals>.")[2]


def run(action: Callable[..., Result], *args: object, **kwargs: object) -> Result:
    """Call an action, and return its result.

    Raises:
        BadArgument: It is a coroutine or generator function, whose call does nothing.
    """
    result = action(*args, **kwargs)
    kind = type(result)  # isinstance() would wait for a future
    if kind is CoroutineType or kind is AsyncGeneratorType:
        if kind is CoroutineType:
            result.close()  # Python warns of those that nobody awaits
        expected = "a plain function; `lambda: asyncio.run(...)` runs an async one to its end"
        raise BadArgument("action", name_of(action), expected)
    if kind is GeneratorType and getgeneratorstate(result) == GEN_CREATED:
        function = _unwrapped(action)
        if hasattr(function, _LAZY) or getattr(function, "__code__", None) is result.gi_code:
            raise BadArgument("action", name_of(action), getattr(function, _LAZY, _NOT_BEGUN))
    return result


def lazy(instead: str) -> Callable[[Function], Function]:
    """Mark a plain function whose work is done by the generator that it returns.

    Args:
        instead: The action to use instead, for the message.
    """

    def mark(function: Function) -> Function:
        setattr(function, _LAZY, instead)
        return function

    return mark


def _unwrapped(action: Callable[..., Result]) -> object:
    """Return the function as it was defined, from within partials, methods, decorators and callable objects."""
    function: Any = action
    while True:
        if isinstance(function, partial):
            function = function.func
        elif isinstance(function, MethodType):
            function = function.__func__
        elif hasattr(function, "__wrapped__"):  # by a decorator
            function = function.__wrapped__
        elif isinstance(function, FunctionType) or not isinstance(type(function).__call__, FunctionType):
            return function
        else:
            function = type(function).__call__
