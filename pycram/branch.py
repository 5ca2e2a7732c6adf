"""Branches: the actions of a block; and handles, which stand for their results.

A handle is what a plan gets at once for an action that may still run. It can be used as the result itself: looking at
its attributes, comparing, printing or iterating waits for the branch to end and then works on the result. Where the
type matters (``isinstance``, ``is``), :func:`unwrap` gives the result.
"""

from __future__ import annotations

import copy
import operator
from contextvars import copy_context
from types import AsyncGeneratorType, CoroutineType
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from pycram.cancellation import checkpoint, wait
from pycram.failures import BadArgument, UsageError
from recorder.span import Span, current
from recorder.tasks import State
from recorder.way import way_here

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Iterator

#: What an action of the plan gives: whatever its process module or function returns.
Result: TypeAlias = Any


class NoResult(UsageError):
    """The result of a branch was used that was cancelled, since its block was decided without it.

    Attributes:
        branch: name of the branch.
    """

    def __init__(self, branch: str) -> None:
        super().__init__(
            f"{branch} has no result: it was cancelled when its block was decided; s.branches tells states"
        )
        self.branch = branch


class Branch:
    """One action of a block, and what came of it.

    It runs in a copy of the context in which it was asked for, in whatever thread the block gives it.

    Attributes:
        name: what people call it; its thread's name too.
        action: what it does; its result is the branch's.
        ordered: whether it waits only for what was asked for before it, and so for nothing that comes later.
        context: where it was asked for.
        span: its node of the task tree.
        thread: the thread that was made for it; None where it runs in that of others.
    """

    def __init__(
        self,
        name: str,
        action: Callable[[], Result],
        changed: threading.Condition,
        *,
        ordered: bool = False,
        dropped: Callable[[], None] = lambda: None,
        span: Span | None = None,
    ) -> None:
        """Makes a branch that doesn't run yet.

        Args:
            name: what people call it.
            action: what it does.
            changed: notified when it ends; its block's.
            ordered: see above.
            dropped: called once if it is never begun; must not raise.
            span: its node of the task tree, if it isn't just a branch.
        """
        self.name = name
        self.action = action
        self.ordered = ordered
        self.context = copy_context()
        self.span = span if span is not None else Span("branch", name)
        around = current()
        self.span.source = way_here(around.source if around is not None else None)
        self._dropped = dropped
        self._begun = False
        self._changed = changed
        self.thread: threading.Thread | None = None
        self._state = State.CREATED
        self._result: Result = None
        self._error: BaseException | None = None

    @property
    def state(self) -> State:
        """How far it is."""
        return self._state

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self._state not in (State.CREATED, State.RUNNING)

    @property
    def error(self) -> BaseException | None:
        """What it raised; None while it runs, when it succeeded and when it was cancelled."""
        return self._error

    def begin(self) -> Result:
        """Does its action.

        Returns:
            What that returned.
        """
        self._begun = True
        self._state = State.RUNNING
        return unwrap(completed(self.name, self.action()))

    def settle(self, state: State, result: Result = None, error: BaseException | None = None) -> None:
        """Says what came of it, once.

        Args:
            state: how it ended.
            result: what its action returned.
            error: what its action raised.
        """
        if not self._begun:
            self._dropped()
        with self._changed:
            self._state, self._result, self._error = state, result, error
            self._changed.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """Waits for its end.

        Args:
            timeout: in seconds; None to wait for ever.

        Returns:
            Whether it has ended.

        Raises:
            Cancelled: the one who waits was told to stop.
        """
        return wait(self._changed, lambda: self.done, timeout)

    def outlast(self) -> None:
        """Waits for its end, whoever is told to stop."""
        with self._changed:
            self._changed.wait_for(lambda: self.done)

    def result(self, timeout: float | None = None) -> Result:
        """Waits for its result.

        Args:
            timeout: in seconds; None to wait for ever.

        Returns:
            What its action returned.

        Raises:
            TimeoutError: it still runs.
            Cancelled: the one who waits was told to stop.
            NoResult: the branch was told to stop.
            BaseException: what its action raised.
        """
        if not self.wait(timeout):
            raise TimeoutError(f"{self.name} still runs after {timeout} s")
        if self._state is State.CANCELLED:
            checkpoint()
            raise NoResult(self.name)
        if self._error is not None:
            raise self._error
        return self._result

    def __repr__(self) -> str:
        return f"Branch({self.name!r}, {self._state.word})"


class Handle:
    """Stands for the result of a branch; everything that is done with it is done with the result, once it is there.

    Its own is only :meth:`result`. When the branch failed, using the handle raises what the branch raised. What it is
    the result of tells :func:`branch_of`.
    """

    __slots__ = ("__weakref__", "_branch")
    _branch: Branch

    def __init__(self, branch: Branch) -> None:
        """Makes a handle.

        Args:
            branch: whose result it stands for.
        """
        object.__setattr__(self, "_branch", branch)

    def result(self, timeout: float | None = None) -> Result:
        """Waits for the result itself; see :meth:`Branch.result`."""
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

    def operate(self: Handle, *others: object) -> Result:
        values = [self.result(), *(unwrap(other) for other in others)]
        return function(*(reversed(values) if name in _REFLECTED else values))

    operate.__name__ = name
    return operate


_BINARY: Final = ("add", "sub", "mul", "matmul", "truediv", "floordiv", "mod", "pow", "and", "or", "xor")
_REFLECTED: Final = frozenset(f"__r{name}__" for name in _BINARY)

for _name in (*(f"__{name}__" for name in _BINARY), *_REFLECTED, "__neg__", "__pos__", "__abs__", "__index__"):
    setattr(Handle, _name, _operation(_name))


def completed(action: str, result: Result) -> Result:
    """What a function of the plan returned, if that function has been run.

    Args:
        action: name of the function.
        result: what it returned.

    Raises:
        BadArgument: it is an async function: calling it has done nothing yet.
    """
    kind = type(result)  # isinstance() would wait for a handle
    if kind is not CoroutineType and kind is not AsyncGeneratorType:
        return result
    if kind is CoroutineType:
        result.close()  # Python warns of those that nobody awaits
    raise BadArgument("action", action, "a plain function; `lambda: asyncio.run(...)` runs an async one to its end")


def is_handle(value: object) -> bool:
    """Whether this is a handle, without waiting for what it stands for."""
    return issubclass(type(value), Handle)


def branch_of(value: object) -> Branch | None:
    """The branch whose result a handle stands for; None for anything else. Doesn't wait."""
    branch: Branch | None = object.__getattribute__(value, "_branch") if is_handle(value) else None
    return branch


def unwrap(value: Result) -> Result:
    """The thing itself where a handle stands for it; anything else unchanged.

    Args:
        value: a handle, or not.

    Returns:
        The result; waits for it.

    Raises:
        BaseException: what the branch raised.
    """
    while is_handle(value):
        value = value.result()
    return value
