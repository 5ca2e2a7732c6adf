"""Nesting: scopes of the plan (blocks, attempts, timeouts, cleanups) end in the reverse order of their beginnings.

``with`` statements ensure this, except where a generator leaves a scope open while other code continues. A scope that
ends out of order raises Misnested, after all scopes that were opened after it have ended: else the plan would continue
in a scope that is over. While a scope is open, Ctrl-C is deferred in the language's own code
(:mod:`recorder.tracing.interrupts`).

The context of a block's body carries the block; :func:`sequential` runs code of the body in order, outside of branches.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from contextlib import ContextDecorator, contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import TYPE_CHECKING, Final, Generic, NamedTuple, ParamSpec, TypeVar

from pycram.foundation.failures import UsageError
from pycram.scheduling.cancellation import Binding, body as body_context, raise_if_cancelled
from pycram.scheduling.schedule import scheduler
from recorder.tracing import interrupts
from recorder.tracing.call_stack import is_resumable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager
    from types import TracebackType

    from pycram.scheduling.cancellation import Body

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")


class Misnested(UsageError):
    """A block was ended while a block that was opened after it was still open.

    Attributes:
        block: Its kind; here timeouts, attempts and cleanups are blocks too.
    """

    def __init__(self, block: str) -> None:
        super().__init__(
            f"a {block} block ends while one that was opened after it is open, or in another branch than it began; "
            "a generator that yields in the body of a block has to get to the block's end before others go on"
        )
        self.block = block


class _Open(NamedTuple):
    """A scope that is open."""

    scope: object  # of the ``with`` statement
    generator: int  # id of the generator whose code opened it; 0 for code that isn't resumable
    body: AbstractContextManager[object]  # does the work
    defers: bool  # whether it defers Ctrl-C

    def end(self, error: BaseException | None, trace: TracebackType | None = None) -> bool | None:
        try:
            return self.body.__exit__(type(error) if error is not None else None, error, trace)
        finally:
            if self.defers:
                interrupts.leave()


_open: Final[ContextVar[tuple[_Open, ...]]] = ContextVar("pycram_open", default=())


class Scope(ABC, Generic[Value]):
    """A context manager that refuses to end out of order; reusable, also within itself."""

    def __init__(self, name: str) -> None:
        self._name = name  # its kind, in messages

    @abstractmethod
    def _opened(self) -> AbstractContextManager[Value]:
        """Return a new context manager that does the work."""

    def __enter__(self) -> Value:
        defers = interrupts.enter(scheduler())
        try:
            body = self._opened()
            value = body.__enter__()
        except BaseException:
            if defers:
                interrupts.leave()
            raise
        _open.set((*_open.get(), _Open(self, _generator(), body, defers)))
        return value

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        opened, generator = _open.get(), _generator()
        indices = [i for i, scope in enumerate(opened) if scope.scope is self and scope.generator == generator]
        if indices and indices[-1] == len(opened) - 1:
            _open.set(opened[:-1])
            return opened[-1].end(error, trace)
        raised = error if isinstance(error, KeyboardInterrupt) else Misnested(self._name)
        while indices and len(_open.get()) > indices[-1]:
            *outer, last = _open.get()
            _open.set(tuple(outer))
            last.end(raised)
        if raised is error or (error is not None and not indices):  # it was ended so before
            return False
        raise raised


def _generator() -> int:
    """Return the id of the generator whose code opens or ends a scope; 0 for code that isn't resumable.

    It is needed because ``par`` is the same object in all ``with`` statements.
    """
    frame = sys._getframe(2)  # noqa: SLF001  inspect.currentframe() gives no other
    while frame.f_back is not None and frame.f_globals.get("__name__") == "contextlib":  # ExitStack
        frame = frame.f_back
    return id(frame) if is_resumable(frame) else 0


class GeneratorScope(Scope[Value], ContextDecorator):
    """A scope that is written as a generator, by :func:`scope`; also a decorator."""

    def __init__(self, name: str, make: Callable[[], AbstractContextManager[Value]]) -> None:
        super().__init__(name)
        self._make = make

    def _opened(self) -> AbstractContextManager[Value]:
        return self._make()


def scope(function: Callable[Arguments, Iterator[Value]]) -> Callable[Arguments, GeneratorScope[Value]]:
    """Turn a generator function that yields once into a scope, as ``contextlib.contextmanager`` does."""
    make = contextmanager(function)
    name = function.__name__.rstrip("_")

    @wraps(function)
    def made(*args: Arguments.args, **kwargs: Arguments.kwargs) -> GeneratorScope[Value]:
        return GeneratorScope(name, lambda: make(*args, **kwargs))

    return made


# --- bodies of blocks -------------------------------------------------------------------------------------------------


def in_block(host: Body | None) -> Binding[Body | None]:
    """Make actions in the ``with`` block branches of a block; with None, run them in order."""
    return Binding(body_context, host)


def leave_body() -> None:
    """Make this context that of a branch, for good: actions run in order, and it ends only scopes that it opens."""
    body_context.set(None)
    nothing_open()


def nothing_open() -> None:
    """Forget the open scopes of this context."""
    _open.set(())


def await_turn() -> None:
    """Wait until code of the body may run itself: in a body that is read, until its turn comes.

    Raises:
        Cancelled: The block around it is cancelled.
    """
    host = body_context.get()
    if host is not None:
        host.await_turn()


@contextmanager
def sequential() -> Iterator[Callable[[], None]]:
    """Run the ``with`` block in the branch of the body, in order; failures propagate as in plain Python.

    Yields:
        A function to call at the end; it waits for the branches that the body added to a sequence around it.

    Raises:
        Cancelled: The block around it is cancelled.
    """
    await_turn()
    raise_if_cancelled()
    host = body_context.get()
    with in_block(None):
        yield host.await_turn if host is not None else lambda: None
