"""Nesting: scopes of the plan (blocks, attempts, timeouts, cleanups) end in the opposite order of their beginnings.

``with`` statements see to that, except where generators leave one open and others go on. A scope that ended in the
place of another would leave the plan in one that is over. So what ends out of order is ended, with all that was opened
after it, and refused. As long as a scope is open, Ctrl-C is held back in the language's own code
(:mod:`recorder.tracing.interrupts`).
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from contextlib import ContextDecorator, contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import TYPE_CHECKING, Final, Generic, NamedTuple, ParamSpec, TypeVar

from pycram.foundation.failures import UsageError
from pycram.scheduling.schedule import scheduler
from recorder.tracing import interrupts
from recorder.tracing.call_site import is_resumable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager
    from types import TracebackType

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")


class Misnested(UsageError):
    """A block was ended while another one was open that had been opened after it.

    Attributes:
        block: what kind it is; a timeout, an attempt and a cleanup are blocks in this too.
    """

    def __init__(self, block: str) -> None:
        super().__init__(
            f"a {block} block ends while one that was opened after it is open, or in another branch than it began; "
            "a generator that yields in the body of a block has to get to the block's end before others go on"
        )
        self.block = block


class _Open(NamedTuple):
    """A scope that is open.

    Attributes:
        opening: what stands in the ``with`` statement.
        generator: identifies the generator whose code began it; 0 for code that is never left in the middle.
        body: what begins and ends in truth.
        held: whether it has Ctrl-C held back.
    """

    opening: object
    generator: int
    body: AbstractContextManager[object]
    held: bool

    def end(self, error: BaseException | None, trace: TracebackType | None = None) -> bool | None:
        try:
            return self.body.__exit__(type(error) if error is not None else None, error, trace)
        finally:
            if self.held:
                interrupts.leave()


_open: Final[ContextVar[tuple[_Open, ...]]] = ContextVar("pycram_open", default=())


class Scope(ABC, Generic[Value]):
    """Something for a ``with`` statement that has to end in its turn; may be used again, also within itself."""

    def __init__(self, name: str) -> None:
        """Makes one that isn't open.

        Args:
            name: what kind it is.
        """
        self._name = name

    @abstractmethod
    def _opened(self) -> AbstractContextManager[Value]:
        """What begins and ends in truth; a new one each time."""

    def __enter__(self) -> Value:
        held = interrupts.enter(scheduler())
        try:
            body = self._opened()
            value = body.__enter__()
        except BaseException:
            if held:
                interrupts.leave()
            raise
        _open.set((*_open.get(), _Open(self, _generator(), body, held)))
        return value

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        opened, generator = _open.get(), _generator()
        if opened and opened[-1].opening is self and opened[-1].generator == generator:
            _open.set(opened[:-1])
            return opened[-1].end(error, trace)
        here = [place for place, one in enumerate(opened) if one.opening is self and one.generator == generator]
        wrong = error if isinstance(error, KeyboardInterrupt) else Misnested(self._name)
        while here and len(_open.get()) > here[-1]:
            *kept, last = _open.get()
            _open.set(tuple(kept))
            last.end(wrong)
        if wrong is error or (error is not None and not here):  # one that was ended like that before
            return False
        raise wrong


def nothing_open() -> None:
    """From here on nothing is open in this context: it is that of a branch, which ends only what it begins itself."""
    _open.set(())


def _generator() -> int:
    """Identifies the generator whose code opens or ends a scope; 0 for code that is never left in the middle.

    The word ``par`` is the same object in all ``with`` statements, so the scope alone doesn't tell them apart.
    """
    frame = sys._getframe(2)  # noqa: SLF001  inspect.currentframe() gives no other
    while frame.f_back is not None and frame.f_globals.get("__name__") == "contextlib":  # ExitStack
        frame = frame.f_back
    return id(frame) if is_resumable(frame) else 0


class GeneratorScope(Scope[Value], ContextDecorator):
    """A scope that is written as a generator; serves as decorator too."""

    def __init__(self, name: str, opened: Callable[[], AbstractContextManager[Value]]) -> None:
        """Makes one; :func:`scope` is there for that."""
        super().__init__(name)
        self._made = opened

    def _opened(self) -> AbstractContextManager[Value]:
        return self._made()


def scope(function: Callable[Arguments, Iterator[Value]]) -> Callable[Arguments, GeneratorScope[Value]]:
    """As ``contextlib.contextmanager``, for what has to end in its turn.

    Args:
        function: a generator function that yields once.
    """
    begin = contextmanager(function)
    name = function.__name__.rstrip("_")

    @wraps(function)
    def made(*args: Arguments.args, **kwargs: Arguments.kwargs) -> GeneratorScope[Value]:
        return GeneratorScope(name, lambda: begin(*args, **kwargs))

    return made
