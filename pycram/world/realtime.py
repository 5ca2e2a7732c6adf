"""Real time: a thread that simulates a world at the pace of the clock until it is stopped."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import ChangeRefused, WorldClosed
from pycram.scheduling.cancellation import join
from pycram.scheduling.schedule import Condition

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld

_PERIOD: Final = 1 / 30  # s; each period's simulation is one record
_MAX_LAG: Final = 0.1  # s that are caught up; more is dropped, as a slow machine can never catch up


class RealtimeClock:
    """A thread that simulates one world."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._stop = threading.Event()
        self._error: BaseException | None = None
        self._over = False
        self._ended = Condition()
        # the world's exit() ends it; it is a daemon for plans that don't call exit()
        self._thread = threading.Thread(target=self._run, name=f"{world.name} realtime", daemon=True)

    def start(self) -> None:
        """Start simulating."""
        self._thread.start()

    def stop(self) -> None:
        """Stop and wait for the present simulation to end; never call it with the world's lock held.

        Raises:
            Exception: The first error that a handler of an event raised in the clock's thread.
        """
        self._stop.set()
        if self._thread is not threading.current_thread():
            join(self._ended, lambda: self._over)  # a handler of its last stretch may wait for another branch
            self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            self._simulate()
        finally:
            self._over = True
            self._ended.notify_all()

    def _simulate(self) -> None:
        due = time.monotonic()
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            due = max(due + _PERIOD, time.monotonic() - _MAX_LAG)
            try:
                self._world.simulate(_PERIOD)
            except WorldClosed:
                return
            except ChangeRefused:  # a query runs at the moment
                continue
            except Exception as error:  # noqa: BLE001  of a handler: time goes on
                self._keep(error)

    def _keep(self, error: Exception) -> None:
        """Report the first error at once, and keep it for the caller of :meth:`stop`."""
        if self._error is None:
            self._error = error
            threading.excepthook(threading.ExceptHookArgs((type(error), error, error.__traceback__, self._thread)))
