"""Futures: what a plan gets at once for an action that may still run.

A future can be used as the result itself: looking at its attributes, comparing, calculating, printing or iterating
waits for the branch to end and then works on the result. Where the type matters (``is``, ``json.dumps``, ``str.join``),
:func:`unwrap` gives the result.
"""

from __future__ import annotations

import copy
import operator
import os
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias

from recorder.tasks import State

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


Result: TypeAlias = Any


class Pending(Protocol):
    """What a future stands for, as far as its result is concerned: a branch of a block."""

    name: str
    state: State
    ordered: bool

    @property
    def done(self) -> bool:
        """Whether it has ended."""

    def result(self, timeout: float | None = None) -> Result:
        """Wait for its result."""


class Future:
    """Stands for the result of a branch; everything that is done with it is done with the result, once it is there.

    Its own is only :meth:`result`. When the branch failed, using the future raises what the branch raised. What it is
    the result of tells :func:`branch_of`.
    """

    __slots__ = ("__weakref__", "_branch")
    _branch: Pending

    def __init__(self, branch: Pending) -> None:
        """Makes a future.

        Args:
            branch: whose result it stands for.
        """
        object.__setattr__(self, "_branch", branch)

    def result(self, timeout: float | None = None) -> Result:
        """Waits for the result itself; see :meth:`pycram.language.branch.Branch.result`."""
        return self._branch.result(timeout)

    def __record__(self) -> object:
        """Its result; the branch's name as long as there is none, so that recording waits for nobody."""
        branch = self._branch
        return branch.result() if branch.state is State.SUCCEEDED else {"branch": branch.name}

    @property  # type: ignore[misc]
    def __class__(self) -> type:  # isinstance() asks for this, after the type itself
        return type(self._branch.result())

    def __getattr__(self, name: str) -> Result:
        return getattr(self._branch.result(), name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self._branch.result(), name, value)

    def __delattr__(self, name: str) -> None:
        delattr(self._branch.result(), name)

    def __repr__(self) -> str:
        branch = self._branch
        return repr(branch.result()) if branch.state is State.SUCCEEDED else f"<result of {branch!r}>"

    def __str__(self) -> str:
        return str(self._branch.result())

    def __eq__(self, other: object) -> bool:
        if other is self:
            return True
        return bool(self._branch.result() == unwrap(other))

    def __hash__(self) -> int:
        return hash(self._branch.result())

    def __bool__(self) -> bool:
        return bool(self._branch.result())

    def __len__(self) -> int:
        return len(self._branch.result())

    def __iter__(self) -> Iterator[Result]:
        return iter(self._branch.result())

    def __contains__(self, item: object) -> bool:
        return item in self._branch.result()

    def __getitem__(self, key: object) -> Result:
        return self._branch.result()[key]

    def __setitem__(self, key: object, value: object) -> None:
        self._branch.result()[unwrap(key)] = value

    def __delitem__(self, key: object) -> None:
        del self._branch.result()[unwrap(key)]

    def __format__(self, spec: str) -> str:
        return format(self._branch.result(), spec)

    def __round__(self, digits: int | None = None) -> Result:
        return round(self._branch.result(), digits)

    def __divmod__(self, other: object) -> Result:
        return divmod(self._branch.result(), unwrap(other))

    def __rdivmod__(self, other: object) -> Result:
        return divmod(other, self._branch.result())

    def __reversed__(self) -> Iterator[Result]:
        return reversed(self._branch.result())

    def __next__(self) -> Result:
        return next(self._branch.result())

    def __enter__(self) -> Result:
        """Enters the result."""
        return self._branch.result().__enter__()

    def __exit__(self, *raised: object) -> Result:
        """Leaves the result."""
        return self._branch.result().__exit__(*raised)

    def __fspath__(self) -> str | bytes:
        return os.fspath(self._branch.result())

    def __reduce__(self) -> Result:
        return unwrap, (self._branch.result(),)

    def __copy__(self) -> Result:
        return copy.copy(self._branch.result())

    def __deepcopy__(self, memo: dict[int, object]) -> Result:
        return copy.deepcopy(self._branch.result(), memo)

    def __call__(self, *args: object, **kwargs: object) -> Result:
        """Calls the result."""
        return self._branch.result()(*args, **kwargs)

    def __float__(self) -> float:
        return float(self._branch.result())

    def __int__(self) -> int:
        return int(self._branch.result())

    def __lt__(self, other: object) -> bool:
        return bool(self._branch.result() < unwrap(other))

    def __le__(self, other: object) -> bool:
        return bool(self._branch.result() <= unwrap(other))

    def __gt__(self, other: object) -> bool:
        return bool(self._branch.result() > unwrap(other))

    def __ge__(self, other: object) -> bool:
        return bool(self._branch.result() >= unwrap(other))


def _operation(name: str) -> Callable[..., Result]:
    function = getattr(operator, name.replace("__r", "__", 1) if name in _REFLECTED else name)

    def operate(self: Future, *others: object) -> Result:
        values = [self.result(), *(unwrap(other) for other in others)]
        return function(*(reversed(values) if name in _REFLECTED else values))

    operate.__name__ = name
    return operate


_BINARY: Final = (
    "add",
    "sub",
    "mul",
    "matmul",
    "truediv",
    "floordiv",
    "mod",
    "pow",
    "and",
    "or",
    "xor",
    "lshift",
    "rshift",
)
_REFLECTED: Final = frozenset(f"__r{name}__" for name in _BINARY)

for _name in (
    *(f"__{name}__" for name in _BINARY),
    *_REFLECTED,
    "__neg__",
    "__pos__",
    "__abs__",
    "__invert__",
    "__index__",
):
    setattr(Future, _name, _operation(_name))


def is_future(value: object) -> bool:
    """Whether this is a future, without waiting for what it stands for."""
    return issubclass(type(value), Future)


def branch_of(value: object) -> Pending | None:
    """The branch whose result a future stands for; None for anything else. Doesn't wait."""
    branch: Pending | None = object.__getattribute__(value, "_branch") if is_future(value) else None
    return branch


def branches_in(value: object) -> Iterator[Pending]:
    """The branches of all futures in a value: of itself, and of those in lists, tuples and dictionaries, however deep.

    Doesn't wait. Who waits for each before asking for the next gets those in their results too.

    Args:
        value: anything.
    """
    queue = [value]
    seen = set()
    for one in queue:
        branch = branch_of(one)
        if branch is not None:
            yield branch
            if branch.state is State.SUCCEEDED:
                queue.append(branch.result())
        elif isinstance(one, (list, tuple, dict)) and id(one) not in seen:
            seen.add(id(one))
            queue += one.values() if isinstance(one, dict) else one


def unwrap(value: Result) -> Result:
    """The thing itself where a future stands for it; anything else unchanged.

    Args:
        value: a future, or not.

    Returns:
        The result; waits for it.

    Raises:
        BaseException: what the branch raised.
    """
    while is_future(value):
        value = value.result()
    return value
