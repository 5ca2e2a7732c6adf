"""Futures: results of actions that may still run.

Attributes, comparisons, arithmetic, printing and iteration of a future wait for the branch's end, and then use the
result. If the type matters (``is``, ``json.dumps``, ``str.join``), use :func:`unwrap`.
"""

from __future__ import annotations

import copy
import operator
import os
from collections.abc import Callable, Iterator
from typing import Any, Final, Protocol, TypeAlias

from recorder.tasks import State

Result: TypeAlias = Any


class Pending(Protocol):
    """The branch of a future."""

    name: str
    state: State
    ordered: bool

    @property
    def done(self) -> bool:
        """Whether the branch has ended."""

    def result(self, timeout: float | None = None) -> Result:
        """Wait for the branch's result."""


class Future:
    """The result of a branch: every operation waits for the result, and is applied to it.

    The only method of a future itself is :meth:`result`. Using the future of a failed branch raises the branch's error.
    """

    __slots__ = ("__weakref__", "_branch")
    _branch: Pending

    def __init__(self, branch: Pending) -> None:
        object.__setattr__(self, "_branch", branch)

    def result(self, timeout: float | None = None) -> Result:
        """Wait for the result and return it; see :meth:`pycram.language.branch.Branch.result`."""
        return self._branch.result(timeout)

    def __record__(self) -> object:
        """Return the result, or the branch's name before there is a result, because recording doesn't wait."""
        branch = self._branch
        return branch.result() if branch.state is State.SUCCEEDED else {"branch": branch.name}

    @property  # type: ignore[misc]  # futures are read-only
    def __class__(self) -> type:  # isinstance() reads this attribute after it has read the type
        return type(self._branch.result())

    def __repr__(self) -> str:
        branch = self._branch
        return repr(branch.result()) if branch.state is State.SUCCEEDED else f"<result of {branch!r}>"

    def __eq__(self, other: object) -> bool:
        return other is self or bool(self._branch.result() == unwrap(other))

    def __hash__(self) -> int:
        return hash(self._branch.result())

    def __getattr__(self, name: str) -> Result:
        return getattr(self._branch.result(), name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self._branch.result(), name, value)

    def __getitem__(self, key: object) -> Result:
        return self._branch.result()[unwrap(key)]

    def __setitem__(self, key: object, value: object) -> None:
        self._branch.result()[unwrap(key)] = value

    def __call__(self, *args: object, **kwargs: object) -> Result:
        """Call the result."""
        return self._branch.result()(*args, **kwargs)

    def __enter__(self) -> Result:
        return self._branch.result().__enter__()

    def __exit__(self, *raised: object) -> Result:
        return self._branch.result().__exit__(*raised)

    def __reduce__(self) -> Result:
        return unwrap, (self._branch.result(),)


def _reflected(function: Callable[[Any, Any], Result]) -> Callable[[Any, Any], Result]:
    return lambda result, other: function(other, result)


_BINARY: Final = "add sub mul matmul truediv floordiv mod pow and or xor lshift rshift"
_OTHERS: Final = "lt le gt ge neg pos abs invert index contains delitem"
_BUILTIN: Final = (bool, delattr, divmod, float, format, int, iter, len, next, reversed, round, str)
_FUNCTIONS: Final[dict[str, Callable[..., Result]]] = {
    **{name: getattr(operator, f"__{name}__") for name in f"{_BINARY} {_OTHERS}".split()},
    **{f"r{name}": _reflected(getattr(operator, f"__{name}__")) for name in _BINARY.split()},
    **{function.__name__: function for function in (*_BUILTIN, copy.copy, copy.deepcopy, os.fspath)},
    "rdivmod": _reflected(divmod),
}
"""The functions of ``__add__``, ``__len__`` and so on. They are applied to the results of futures."""


def _operation(name: str, function: Callable[..., Result]) -> Callable[..., Result]:
    def operate(self: Future, *others: object) -> Result:
        return function(self.result(), *map(unwrap, others))

    operate.__name__ = name
    return operate


for _name, _function in _FUNCTIONS.items():
    setattr(Future, f"__{_name}__", _operation(f"__{_name}__", _function))


def is_future(value: object) -> bool:
    """Return whether a value is a future, without waiting."""
    return issubclass(type(value), Future)


def branch_of(value: object) -> Pending | None:
    """Return the branch of a future without waiting; None for other values."""
    return object.__getattribute__(value, "_branch") if is_future(value) else None


def branches_in(value: object) -> Iterator[Pending]:
    """Yield the branches of all futures in a value, also in nested lists, tuples and dictionaries, without waiting.

    A caller that waits for each branch before the next also gets the branches of futures in results.
    """
    queue = [value]
    seen = set()
    for item in queue:
        branch = branch_of(item)
        if branch is not None:
            yield branch
            if branch.state is State.SUCCEEDED:
                queue.append(branch.result())
        elif isinstance(item, (list, tuple, dict)) and id(item) not in seen:
            seen.add(id(item))
            queue += item.values() if isinstance(item, dict) else item


def unwrap(value: Result) -> Result:
    """Wait for a future's result and return it, or raise the branch's error; return other values unchanged."""
    while is_future(value):
        value = value.result()
    return value
