"""What code in the body of a block knows of it: which block's branches its actions are, and when it may act itself."""

from __future__ import annotations

from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

from pycram.language.nesting import nothing_open
from pycram.scheduling.binding import Binding
from pycram.scheduling.cancellation import raise_if_cancelled

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pycram.language.block import Block

_host: ContextVar[Block | None] = ContextVar("pycram_block", default=None)


def current_block() -> Block | None:
    """The block whose branches are the actions here; None where actions happen one after the other and raise."""
    return _host.get()


def in_block(host: Block | None) -> Binding[Block | None]:
    """Makes actions in its ``with`` block branches of a block.

    Args:
        host: the block; None lets actions happen one after the other.
    """
    return Binding(_host, host)


def leave_body() -> None:
    """From here on this context is that of a branch, in which actions happen one after the other."""
    _host.set(None)
    nothing_open()


def await_turn() -> None:
    """Waits until the code here may act itself: in a body that is only read, that is when its turn has come.

    Raises:
        Cancelled: the block around it is decided, or told to stop.
    """
    host = current_block()
    if host is not None:
        host.await_turn()


@contextmanager
def sequential() -> Iterator[Callable[[], None]]:
    """Runs its ``with`` block in the branch of the body, one thing after the other; failures rise as in plain Python.

    Yields:
        What to call at the end: waits for what it asked of a sequence around it.

    Raises:
        Cancelled: the block around it is decided, or told to stop.
    """
    await_turn()
    raise_if_cancelled()
    host = current_block()
    with in_block(None):
        yield host.await_turn if host is not None else lambda: None
