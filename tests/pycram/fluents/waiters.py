"""Somebody who waits for a fluent.

No test waits for time to pass: a network's function tells when somebody who waits has looked at a value.
"""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pycram.fluent import Fluent, network
from pycram.scheduling.cancellation import CancelScope, entered

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


PATIENCE = 20  # s after which a test that hangs fails


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
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive(), "it still waits"
        return self.outcome


@contextmanager
def waiting(fluent: Fluent, timeout: float | None = None) -> Iterator[Running]:
    """Somebody who waits for a fluent, and has looked at its value when the block begins."""
    looked = threading.Event()

    def look(value: object) -> object:
        looked.set()
        return value

    running = Running(lambda: network(look, fluent).wait_for(timeout))
    assert looked.wait(PATIENCE)
    yield running
    running.end()
