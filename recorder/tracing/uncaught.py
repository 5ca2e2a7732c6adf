"""Threads of a plan's own that die of a failure: Python prints it and goes on, so only a record tells it afterwards."""

from __future__ import annotations

import threading
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from recorder.records import Run, failure

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.tracing.journal import Journal


@contextmanager
def uncaught_noted(log: Journal, title: str) -> Iterator[None]:
    """While its block runs, failures that end threads are on record; then whoever was told before is told.

    Args:
        log: where the records go.
        title: of the plan.
    """
    before = threading.excepthook
    ended = False

    def note(told: threading.ExceptHookArgs) -> None:
        try:
            if not ended and told.exc_value is not None and not isinstance(told.exc_value, SystemExit):
                name = (told.thread or threading.current_thread()).name
                with suppress(OSError):  # the next record says so
                    log.append(Run(phase=Run.THREAD_FAILED, name=title, thread=name, failure=failure(told.exc_value)))
        finally:
            before(told)

    threading.excepthook = note
    try:
        yield
    finally:
        ended = True
        if threading.excepthook is note:  # else it stays in the chain of who came later
            threading.excepthook = before
