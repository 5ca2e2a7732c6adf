"""Threads of a plan's own that die of an error: Python prints it and goes on, so only a record keeps it."""

from __future__ import annotations

import threading
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from recorder.records import Run, failure

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.tracing.journal import Journal


@contextmanager
def recording_uncaught(journal: Journal, title: str) -> Iterator[None]:
    """Records the errors that end threads while its block runs; the hook that was set before is called too.

    Args:
        journal: where the records go.
        title: of the plan.
    """
    before = threading.excepthook
    ended = False

    def hook(args: threading.ExceptHookArgs) -> None:
        try:
            if not ended and args.exc_value is not None and not isinstance(args.exc_value, SystemExit):
                name = (args.thread or threading.current_thread()).name
                with suppress(OSError):  # the next record raises it
                    journal.append(
                        Run(phase=Run.THREAD_FAILED, name=title, thread=name, failure=failure(args.exc_value))
                    )
        finally:
            before(args)

    threading.excepthook = hook
    try:
        yield
    finally:
        ended = True
        if threading.excepthook is hook:  # else it stays in the chain of who came later
            threading.excepthook = before
