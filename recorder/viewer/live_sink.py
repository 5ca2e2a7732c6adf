"""Shows a recording live in a Rerun viewer; one that is slow, stalls, dies or isn't there costs the plan nothing.

Records go into a bounded queue. A thread sends them, batch by batch, to a process of its own
(:mod:`recorder.viewer.live_process`) that translates them, and sends the next when the viewer has taken a batch. When
the recording ends, the viewer gets a moment to take what is left; then that process gets the rest, and some time to
deliver it. Records that the viewer did not get are counted and reported: the file has them all, and the number of those
that were dropped.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from multiprocessing import Pipe
from pathlib import Path
from typing import TYPE_CHECKING, Final

from recorder.tracing.forking import own
from recorder.tracing.journal import unrecorded
from recorder.viewer.address import Kind, Target
from recorder.viewer.live_process import Status
from recorder.viewer.live_queue import LiveQueue, is_transient

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from recorder.records import Record
    from recorder.records.asset import AssetFile

_END_TIMEOUT: Final = 1.8  # s for the viewer to take what is left
_START_TIMEOUTS: Final = {Kind.SPAWN: 5.0, Kind.CONNECT: 3.0, Kind.SERVE: 3.0}  # s, for plans that are shorter
_LINGER_TIMEOUT: Final = 30.0  # s after the end of a recording for a viewer that is behind
_HAND_OVER_TIMEOUT: Final = 0.5  # s for the process to read the rest
_BATCH_PERIOD: Final = 0.2  # s: many small batches cost more than they show
_MAX_ITEMS: Final = 500  # of a batch
_MAX_BYTES: Final = 4 << 20
_ROOT: Final = str(Path(__file__).parent.parent.parent)
_NICENESS: Final = 10  # the plan goes first where cores are few, also while the viewer's library is loaded
_CODE: Final = f"""
import os, sys
os.nice({_NICENESS})
sys.path = [*filter(None, sys.path), sys.argv.pop(1)]  # the plan's folder could hold anything
from recorder.viewer.live_process import main
main(sys.argv[1:])
"""


_lingering: Final[list[subprocess.Popen[bytes]]] = []  # processes that deliver the rest


class RerunSink:
    """A sink that is a viewer: "spawn", "connect", "connect:URL", "serve" or a URL.

    Raises:
        RecordingError: ``live`` is none of these.
    """

    def __init__(self, live: str, title: str) -> None:
        self._target = Target.parse(live)
        self._queue = LiveQueue()
        self._records = 0
        self._taken = 0
        self._ended = threading.Event()
        self._settled = threading.Event()  # nothing is waited for: the viewer has all, is gone or isn't there yet
        self._sending = threading.Lock()
        self._started = time.monotonic()
        self._connection, child_end = Pipe()
        with child_end:
            self._process = _start(child_end, live, title)
        self._thread = own(threading.Thread(target=self._run, name="live viewer", daemon=True))
        self._thread.start()

    def final_metadata(self) -> dict[str, str]:
        """Metadata about the viewer, for the end of the file."""
        return {"viewer_dropped": str(self._queue.dropped)}

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Takes a record; see :class:`recorder.tracing.journal.Sink`."""
        self._records += 1
        self._queue.put((topic, payload), transient=is_transient(record))

    def attach(self, asset: AssetFile) -> None:
        """Takes a file; see :class:`recorder.tracing.journal.Sink`."""
        self._queue.put(asset, transient=False)

    def flush(self) -> None:
        """A viewer keeps nothing safe; see :class:`recorder.tracing.journal.Sink`."""

    def close(self) -> None:
        """Ends; waits for the viewer up to a timeout."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._queue.close()
        started = self._started + _START_TIMEOUTS[self._target.kind] - time.monotonic()
        settled = self._settled.wait(max(_END_TIMEOUT, started))
        behind = not settled and self._hand_over()
        served = self._target.kind is Kind.SERVE
        if served and (behind or settled) and self._process.poll() is None:
            atexit.register(_stop, self._process, os.getpid())
        elif not behind:
            _stop(self._process)  # frees the thread, if it still waits
        self._thread.join()
        self._connection.close()
        missed = self._records - self._taken
        if missed:
            count = f"{missed} of {self._records} records"
            time_left = "the time that it is served" if served else f"{_LINGER_TIMEOUT:.0f} s"
            late = f"the viewer is {count} behind; it has {time_left} to take them"
            print(
                f"recorder: {late if behind else f'the viewer missed {count}'}; the file has them all", file=sys.stderr
            )

    def _hand_over(self) -> bool:
        """Sends the rest to the process, and unblocks the thread; returns whether the process took it."""
        sender = own(threading.Thread(target=self._give_rest, name="rest for the viewer", daemon=True))
        sender.start()
        sender.join(_HAND_OVER_TIMEOUT)
        if sender.is_alive():  # the process doesn't read any more
            return False
        with socket.socket(fileno=os.dup(self._connection.fileno())) as ending:
            ending.shutdown(socket.SHUT_RD)
        if self._target.kind is Kind.SERVE:  # pages have until this process ends
            return self._process.poll() is None
        if self._process.stdin is not None:
            self._process.stdin.close()  # its timeout begins
        _lingering[:] = [process for process in (*_lingering, self._process) if process.poll() is None]
        return self._process in _lingering

    def _give_rest(self) -> None:
        with self._sending, contextlib.suppress(OSError):
            self._connection.send(self._queue.take_rest())
            self._connection.send([])

    def _run(self) -> None:
        """Sends one batch at a time, in a thread of its own."""
        try:
            while self._connection.recv() is not Status.READY:
                self._settled.set()
            self._settled.clear()
            with unrecorded():  # what a finalizer prints in it would wait for the queue
                while sent := self._send():
                    self._taken += self._connection.recv()
                    self._ended.wait(max(_BATCH_PERIOD, time.monotonic() - sent))  # where cores are few: half of one
            self._connection.recv()
        except (EOFError, OSError):  # the process has ended, and has printed why; or it has got the rest
            self._queue.take_rest()
        finally:
            self._settled.set()

    def _send(self) -> float | None:
        """Waits for a batch and sends it, an empty one at the end; returns when it began to send something."""
        with self._sending:  # what is taken out is sent before the rest
            batch = self._queue.take(_MAX_ITEMS, _MAX_BYTES)
            started = time.monotonic()
            self._connection.send(batch)
        return started if batch else None

    def wait(self) -> None:
        """Waits while pages can be opened: after the end, until somebody ends their server or interrupts."""
        self._process.wait()


def _stop(process: subprocess.Popen[bytes], owner: int | None = None) -> None:
    if owner not in (None, os.getpid()):  # a forked child's end isn't that of its parent's viewer
        return
    with process:  # waits for it, and closes the pipe
        process.kill()


def _start(child_end: Connection, live: str, title: str) -> subprocess.Popen[bytes]:
    """Starts the translating process; its standard input is closed when this one ends, however it ends."""
    return subprocess.Popen(  # noqa: S603  our own code
        [sys.executable, "-c", _CODE, _ROOT, str(child_end.fileno()), live, title, str(_LINGER_TIMEOUT)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        pass_fds=[child_end.fileno()],
        env={"RUST_LOG": "off"} | os.environ | {"RERUN": "on"},  # it prints what matters; the viewer was asked for
    )
