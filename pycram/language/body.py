"""What code in the body of a block knows of it: which block its actions are branches of, and when it may run itself."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, cast

from pycram.language.nesting import nothing_open
from pycram.scheduling.cancellation import Binding, body as _host, raise_if_cancelled

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pycram.language.block import Block
    from pycram.scheduling.cancellation import Body


def current_block() -> Block | None:
    """Return the block that actions become branches of here; None where they run in order and raise."""
    return cast("Block | None", _host.get())


def in_block(host: Block | None) -> Binding[Body | None]:
    """Make actions in the ``with`` block branches of a block; with None, run them in order."""
    return Binding(_host, host)


def leave_body() -> None:
    """Make this context that of a branch, for good: actions run in order."""
    _host.set(None)
    nothing_open()


def await_turn() -> None:
    """Wait until code of the body may run itself: in a body that is read, when its turn has come.

    Raises:
        Cancelled: The block around it is cancelled.
    """
    host = current_block()
    if host is not None:
        host.await_turn()


@contextmanager
def sequential() -> Iterator[Callable[[], None]]:
    """Run the ``with`` block in the branch of the body, in order; failures rise as in plain Python.

    Yields:
        A function to call at the end; it waits for the branches that the body added to a sequence around it.

    Raises:
        Cancelled: The block around it is cancelled.
    """
    await_turn()
    raise_if_cancelled()
    host = current_block()
    with in_block(None):
        yield host.await_turn if host is not None else lambda: None
