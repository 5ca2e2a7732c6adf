"""Threads that wait for fluents.

No test waits for time to pass: a network's function signals that a waiting thread has read a value.
"""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pycram.fluent import Fluent, network
from pycram.scheduling.cancellation import CancelScope, entered

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


HANG_TIMEOUT = 20  # s after which a hanging test fails


class Running:
    """A function in a thread of its own, within a scope."""

    def __init__(self, action: Callable[[], object]) -> None:
        self.scope = CancelScope()
        self.outcome: object = None
        self.thread = threading.Thread(target=self._run, args=(action,), daemon=True)
        self.thread.start()

    def _run(self, action: Callable[[], object]) -> None:
        with entered(self.scope):
            try:
                self.outcome = action()
            except BaseException as error:  # noqa: BLE001  the test looks at it
                self.outcome = error

    def end(self) -> object:
        self.thread.join(HANG_TIMEOUT)
        assert not self.thread.is_alive(), "it still waits"
        return self.outcome


@contextmanager
def waiting(fluent: Fluent, timeout: float | None = None) -> Iterator[Running]:
    """A thread that waits for a fluent, and has read its value when the block begins."""
    looked = threading.Event()

    def look(value: object) -> object:
        looked.set()
        return value

    running = Running(lambda: network(look, fluent).wait_for(timeout))
    assert looked.wait(HANG_TIMEOUT)
    yield running
    running.end()
