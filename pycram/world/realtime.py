"""Real time: simulates a world at the pace of the clock until it is told to stop."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import ChangeRefused, WorldClosed

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld

_FRAME: Final = 1 / 30  # s between stretches; each is one record
_MOST_BEHIND: Final = 0.1  # s of lag that is caught up; more is dropped, as a slow machine can never catch up


class RealtimeClock:
    """A thread that simulates one world.

    Args:
        world: the world.
    """

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._stop = threading.Event()
        self._error: BaseException | None = None
        # not a daemon's: exit() of the world ends it; daemon so that a plan that forgets to exit can end all the same
        self._thread = threading.Thread(target=self._run, name=f"{world.name} realtime", daemon=True)

    def start(self) -> None:
        """Starts simulating."""
        self._thread.start()

    def stop(self) -> None:
        """Stops and waits for the stretch that is being simulated; never call it with the world's lock held.

        Raises:
            Exception: the first error that a handler of an event raised in the clock's thread, where nobody could
                catch it.
        """
        self._stop.set()
        if self._thread is not threading.current_thread():
            self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            due = max(due + _FRAME, time.monotonic() - _MOST_BEHIND)
            try:
                self._world.simulate(_FRAME)
            except WorldClosed:
                return
            except ChangeRefused:  # a query runs at the moment
                continue
            except Exception as error:  # noqa: BLE001  of a handler: time goes on
                self._keep(error)

    def _keep(self, error: Exception) -> None:
        """Tells the first error at once, and keeps it for who stops the clock."""
        if self._error is None:
            self._error = error
            threading.excepthook(threading.ExceptHookArgs((type(error), error, error.__traceback__, self._thread)))
