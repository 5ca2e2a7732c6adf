"""Nesting: stretches of the plan (blocks, attempts, timeouts, cleanups) end in the opposite order of their beginnings.

``with`` statements see to that, except where generators leave one open and others go on. A stretch that ended in
another's place would leave the plan in a scope that is over: what ends out of order is ended, as far as it was opened
later too, and refused.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from contextlib import ContextDecorator, contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import TYPE_CHECKING, Generic, NamedTuple, ParamSpec, TypeVar

from pycram.foundation.failures import UsageError
from recorder.tracing.call_site import is_resumable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager
    from types import TracebackType

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")


class BlocksMixed(UsageError):
    """A block was ended while another one was open that had been opened after it.

    Attributes:
        block: what kind it is; a timeout, an attempt and a cleanup are blocks in this too.
    """

    def __init__(self, block: str) -> None:
        super().__init__(
            f"a {block} block ends while one that was opened after it is open, or in another thread than it began; "
            "a generator that yields in the body of a block has to get to the block's end before others go on"
        )
        self.block = block


class _Begun(NamedTuple):
    """A stretch that has begun.

    Attributes:
        generator: whose code began it; 0 for code that is never left in the middle.
        opening: what stands in the ``with`` statement.
        stretch: what begins and ends in truth.
    """

    generator: int
    opening: object
    stretch: AbstractContextManager[object]


class Nested(ABC, Generic[Value]):
    """Something for a ``with`` statement that has to end in its turn; may be used again, also within itself.

    Ctrl-C may come between the end of the body and that of the stretch. Whoever notices ends what was left open.
    """

    _open: ContextVar[tuple[_Begun, ...]] = ContextVar("pycram_open", default=())

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
        around = self._open.get()
        stretch = self._opened()
        value = stretch.__enter__()
        try:
            self._open.set((*around, _Begun(_generator(), self, stretch)))
        except BaseException as stopped:  # Ctrl-C: there will be no body
            self._open.set(around)
            stretch.__exit__(type(stopped), stopped, stopped.__traceback__)
            raise
        return value

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        ending: _Begun | None = None
        try:
            opened, generator = self._open.get(), _generator()
            if not opened or opened[-1].generator != generator or opened[-1].opening is not self:
                return self._end_mixed(opened, generator, error)
            ending = opened[-1]
            self._open.set(opened[:-1])
            return ending.stretch.__exit__(kind, error, trace)
        except KeyboardInterrupt as stopped:
            if ending is None:
                self._end_mixed(self._open.get(), _generator(), stopped)
            else:  # perhaps it had not begun to end; nothing happens where it has
                ending.stretch.__exit__(KeyboardInterrupt, stopped, stopped.__traceback__)
            raise

    def _end_mixed(self, opened: tuple[_Begun, ...], generator: int, error: BaseException | None) -> bool:
        """Ends all up to the one that was opened here, and refuses what the plan does."""
        stopped = isinstance(error, KeyboardInterrupt)
        wrong = error if error is not None and stopped else BlocksMixed(self._name)
        here = [place for place, one in enumerate(opened) if one.generator == generator and one.opening is self]
        place = here[-1] if here else len(opened)
        for kept, one in reversed(list(enumerate(opened[place:], place))):
            self._open.set(opened[:kept])
            one.stretch.__exit__(type(wrong), wrong, None)
        if stopped or (error is not None and not here):  # one that was ended like that before
            return False
        raise wrong


def nothing_open() -> None:
    """From here on nothing is open in this context: it is that of a branch, which ends only what it begins itself."""
    Nested._open.set(())  # noqa: SLF001  same module


def _generator() -> int:
    """Which generator's code opens or ends a stretch; 0 for code that is never left in the middle."""
    frame = sys._getframe(2)  # noqa: SLF001  inspect.currentframe() gives no other
    while frame.f_back is not None and frame.f_globals.get("__name__") == "contextlib":  # ExitStack
        frame = frame.f_back
    return id(frame) if is_resumable(frame) else 0


class Stretch(Nested[Value], ContextDecorator):
    """A stretch that is written as a generator; serves as decorator too."""

    def __init__(self, name: str, opened: Callable[[], AbstractContextManager[Value]]) -> None:
        """Makes one; :func:`stretch` is there for that."""
        super().__init__(name)
        self._made = opened

    def _opened(self) -> AbstractContextManager[Value]:
        return self._made()


def stretch(
    function: Callable[Arguments, Iterator[Value]],
) -> Callable[Arguments, Stretch[Value]]:
    """As ``contextlib.contextmanager``, for what has to end in its turn.

    Args:
        function: a generator function that yields once.
    """
    begin = contextmanager(function)
    name = function.__name__.rstrip("_")

    @wraps(function)
    def made(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Stretch[Value]:
        return Stretch(name, lambda: begin(*args, **kwargs))

    return made
