"""Branches: one action of a concurrent block, in a thread of its own; and handles, which stand for their results.

A handle is what a plan gets at once for an action that still runs. It can be used as the result itself: looking at its
attributes, comparing, printing or iterating waits for the branch to end and then works on the result. Where the type
matters (``isinstance``, ``is``), :func:`unwrap` gives the result.
"""

from __future__ import annotations

import contextvars
import threading
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias

from pycram.cancellation import Cancelled, checkpoint, wait
from pycram.failures import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: What an action of the plan gives: whatever its process module or function returns.
Result: TypeAlias = Any


class State(Enum):
    """How far a block or branch is, or how it ended."""

    CREATED = "created"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"


class NoResult(UsageError):
    """The result of a branch was used that was cancelled, since its block was decided without it.

    Attributes:
        branch: name of the branch.
    """

    def __init__(self, branch: str) -> None:
        super().__init__(f"{branch} has no result: it was cancelled when its block was decided; ask its state first")
        self.branch = branch


class Branch:
    """One action, in its own thread, in a copy of the context in which it was made.

    Attributes:
        name: what people call it; its thread's name too.
        ordered: whether it waits only for what was asked for before it, and so for nothing that comes later.
    """

    def __init__(
        self, name: str, action: Callable[[], Result], *, ordered: bool = False, ended: Callable[[Branch], None]
    ) -> None:
        """Makes a branch; :meth:`start` lets it run.

        Args:
            name: what people call it.
            action: what it does; its result is the branch's.
            ordered: see above.
            ended: called in the branch's thread when its outcome is known; must not raise.
        """
        self.name = name
        self.ordered = ordered
        self._action = action
        self._ended = ended
        self._changed = threading.Condition()
        self._state = State.CREATED
        self._result: Result = None
        self._error: BaseException | None = None
        self._context = contextvars.copy_context()
        self._thread = threading.Thread(target=self._context.run, args=(self._run,), name=name)

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
        """What it raised; None while it runs and when it succeeded."""
        return self._error

    def start(self) -> None:
        """Lets it run.

        Raises:
            RuntimeError: the system gives no more threads.
        """
        self._state = State.RUNNING
        try:
            self._thread.start()
        except RuntimeError as error:
            self._settle(State.FAILED, None, error)
            raise

    def join(self) -> None:
        """Waits until its thread has ended."""
        if self._thread.ident is not None:
            self._thread.join()

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
        if not wait(self._changed, lambda: self.done, timeout):
            raise TimeoutError(f"{self.name} still runs after {timeout} s")
        if self._state is State.CANCELLED:
            checkpoint()
            raise NoResult(self.name)
        if self._error is not None:
            raise self._error
        return self._result

    def _run(self) -> None:
        try:
            result = unwrap(self._action())
        except Cancelled as error:
            self._settle(State.CANCELLED, None, error)
        except BaseException as error:  # noqa: BLE001  the block raises it in the thread that opened it
            self._settle(State.FAILED, None, error)
        else:
            self._settle(State.SUCCEEDED, result, None)

    def _settle(self, state: State, result: Result, error: BaseException | None) -> None:
        with self._changed:
            self._state, self._result, self._error = state, result, error
            self._changed.notify_all()
        self._ended(self)

    def __repr__(self) -> str:
        return f"Branch({self.name!r}, {self._state.value})"


class Handle:
    """Stands for the result of a branch; everything that is done with it is done with the result, once it is there.

    Its own is only :meth:`result`. When the branch failed, using the handle raises what the branch raised.
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
    while (branch := branch_of(value)) is not None:
        value = branch.result()
    return value
