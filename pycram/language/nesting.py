"""Scopes of the plan (blocks, attempts, timeouts, cleanups), which end in the reverse order of their beginnings.

``with`` statements ensure this order, unless a generator leaves a scope open while other code continues. A scope that
ends out of order ends all later scopes and raises Misnested, so the plan can't continue in an ended scope. While a
scope is open, the code of the plan language defers Ctrl-C (:mod:`recorder.tracing.interrupts`).
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ContextDecorator, contextmanager
from contextvars import ContextVar
from functools import wraps
from inspect import CO_ASYNC_GENERATOR, CO_COROUTINE, CO_GENERATOR
from types import TracebackType
from typing import Any, Final, Generic, NamedTuple, ParamSpec, TypeVar

from pycram.foundation.errors import chained, raise_unchanged
from pycram.foundation.failures import BadArgument, PlanFailure, UsageError
from pycram.language.branch import name_of, run
from pycram.language.failures import NotCleanedUp, Retry
from pycram.scheduling.cancellation import Binding, BlockBody, body as body_context, raise_if_cancelled, shielded
from pycram.scheduling.schedule import scheduler
from recorder.tracing import interrupts
from recorder.tracing.span import Cancelled, span

_RESUMABLE: Final = CO_GENERATOR | CO_COROUTINE | CO_ASYNC_GENERATOR  # code that others can resume, such as generators

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")


class Misnested(UsageError):
    """An outer block ended before an inner block."""

    def __init__(self, block: str) -> None:
        super().__init__(
            f"a {block} block must end in the branch that opened it, after all blocks inside it; "
            "a generator that yields inside a block must leave the block before other code continues"
        )
        self.block = block  # kind of the scope: "par", "timeout", ...


class _Open(NamedTuple):
    scope: object  # object after ``with``
    generator: int  # id() of the frame of the generator that opened the scope; 0 outside of generators
    body: AbstractContextManager[object]  # the context manager that does the work
    defers: bool  # whether the scope defers Ctrl-C

    def end(self, error: BaseException | None, trace: TracebackType | None = None) -> bool | None:
        try:
            return self.body.__exit__(type(error) if error is not None else None, error, trace)
        finally:
            if self.defers:
                interrupts.leave()


_open: Final[ContextVar[tuple[_Open, ...]]] = ContextVar("pycram_open", default=())


class Scope(ABC, Generic[Value]):
    """A reusable context manager, also for nested blocks, that rejects an end out of order."""

    def __init__(self, name: str) -> None:
        self._name = name  # kind of the scope, for messages

    @abstractmethod
    def _opened(self) -> AbstractContextManager[Value]:
        """Return a new context manager that does the work."""

    def __enter__(self) -> Value:
        defers, entered = interrupts.enter(scheduler()), False
        try:
            body = self._opened()
            value = body.__enter__()
            entered = True
        finally:
            if defers and not entered:
                interrupts.leave()
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
        if raised is error or (error is not None and not indices):  # another scope has ended this scope
            return False
        raise raised


def _generator() -> int:
    """Return the id() of the generator's frame that opens or ends a scope; 0 outside of generators.

    Several ``with`` statements may use the same object, such as ``par``; the generators distinguish these statements.
    """
    frame = sys._getframe(2)  # noqa: SLF001  inspect.currentframe() returns only this frame
    while frame.f_back is not None and frame.f_globals.get("__name__") == "contextlib":  # skip frames of ExitStack
        frame = frame.f_back
    return id(frame) if frame.f_code.co_flags & _RESUMABLE else 0


class GeneratorScope(Scope[Value], ContextDecorator):
    """A scope and decorator that :func:`scope` makes from a generator."""

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


def in_block(host: BlockBody | None) -> Binding[BlockBody | None]:
    """Make actions in the ``with`` block branches of ``host``; if ``host`` is None, run actions in order."""
    return Binding(body_context, host)


def leave_body() -> None:
    """Turn the present context into a branch's context: actions run in order, and code can't end outer scopes."""
    body_context.set(None)
    nothing_open()


def nothing_open() -> None:
    """Forget the open scopes of this context."""
    _open.set(())


def await_turn() -> None:
    """Wait until the code in the ``with`` block may run; see :class:`pycram.language.block.ReadBlock`."""
    host = body_context.get()
    if host is not None:
        host.await_turn()


@contextmanager
def sequential() -> Iterator[Callable[[], None]]:
    """Run the ``with`` block in order. The yielded function waits for the body's branches in an outer sequence."""
    await_turn()
    raise_if_cancelled()
    host = body_context.get()
    with in_block(None):
        yield host.await_turn if host is not None else lambda: None


@scope
def finally_(action: Callable[..., Any], *args: object, **kwargs: object) -> Iterator[None]:
    """Run a cleanup action after the ``with`` block, even after an error; in the block, actions run in order.

    In a cancelled branch, Python's ``finally`` can't move the robot, but this cleanup can. If both block and cleanup
    fail, the block's failure is raised, with the cleanup's failure as its context; a usage error takes precedence.

    Raises:
        BadArgument: The action isn't callable.
        NotCleanedUp: The action failed after a cancellation. The block that cancelled the branch raises the error.
    """
    if not callable(action):
        raise BadArgument("action", action, "a function")
    first: BaseException | None = None
    with sequential() as settle:
        try:
            yield
            settle()
        except BaseException as error:  # noqa: BLE001  raised below
            first = error
        try:
            with shielded(), span("cleanup", name_of(action)) as task:
                task.result = run(action, *args, **kwargs)
        except BaseException as second:  # the error is raised below, or chained with the first error
            if first is None:
                raise
            bug = isinstance(first, PlanFailure) and not isinstance(second, PlanFailure)
            if isinstance(first, Cancelled) and isinstance(second, PlanFailure):
                first = chained(NotCleanedUp(name_of(action), second), [first])
            elif bug or isinstance(first, (Cancelled, Retry)):
                first = chained(second, [first])
            else:
                first = chained(first, [second])
    if first is not None:
        raise_unchanged(first)
