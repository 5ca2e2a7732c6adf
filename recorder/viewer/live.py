"""Show a recording live in a Rerun viewer. A slow or missing viewer doesn't delay the plan.

Records go into a bounded queue (:class:`LiveQueue`). A thread sends batches of records to a separate process
(:func:`main`), because a viewer can block its client, fill the client's memory or prevent the client's exit. The
process answers with its :class:`Status`, then with each batch's number of shown records. An empty batch is the last.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections import OrderedDict, deque
from collections.abc import Iterator
from enum import Enum
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.errors import RecordingError
from recorder.records import TOPICS, Event, Fluent, Mutation, Output, Record
from recorder.records.values import AssetFile
from recorder.tracing.forking import own
from recorder.tracing.journal import NullSink, unrecorded
from recorder.viewer.connection import (
    END_TIMEOUT,
    Target,
    ViewerGone,
    ViewerKind,
    ViewerWindow,
    answers,
    wait_for_answer,
)

if TYPE_CHECKING:
    import rerun as rr

    from recorder.viewer.translator import Translator

_END_TIMEOUT: Final = 1.8  # timeout in s for the viewer to take the remaining records
#: Time in s for a viewer to start, even if the plan ends earlier.
_START_TIMEOUTS: Final = {ViewerKind.SPAWN: 5.0, ViewerKind.CONNECT: 3.0, ViewerKind.SERVE: 3.0}
_LINGER_TIMEOUT: Final = 30.0  # maximum time in s to wait for a late viewer after the end of a recording
_HAND_OVER_TIMEOUT: Final = 0.5  # timeout in s for the process to read the remaining records
_BATCH_PERIOD: Final = 0.2  # time in s between batches; many small batches would cost too much
_MAX_ITEMS: Final = 500  # maximum number of items in a batch
_MAX_BYTES: Final = 4 << 20
_ROOT: Final = str(Path(__file__).parent.parent.parent)
_NICENESS: Final = 10  # with few cores, the plan has priority
_CODE: Final = f"""
import os, sys
os.nice({_NICENESS})
sys.path = [*filter(None, sys.path), sys.argv.pop(1)]  # the plan's folder may have modules of any name
from recorder.viewer.live import main
main(sys.argv[1:])
"""

_lingering: Final[list[subprocess.Popen[bytes]]] = []  # processes that are still delivering records


class RerunSink(NullSink):
    """A sink that shows records in a viewer; raises RecordingError for a wrong ``live`` (:func:`recorder.record`)."""

    def __init__(self, live: str, title: str) -> None:
        self._target = Target.parse(live)
        if not hasattr(os, "fork"):  # systems without fork can't pass pipes to processes
            hint = "record to a file, and show the file with pycram-replay view"
            raise RecordingError(live, "this system can't pass an open pipe to a process", hint)
        self._queue = LiveQueue()
        self._records = 0
        self._taken = 0
        self._ended = threading.Event()
        self._settled = threading.Event()  # set when the viewer has all records, is gone or hasn't started
        self._sending = threading.Lock()
        self._started = time.monotonic()
        self._connection, child_end = Pipe()
        with child_end:
            self._process = subprocess.Popen(  # noqa: S603
                [sys.executable, "-c", _CODE, _ROOT, str(child_end.fileno()), live, title, str(_LINGER_TIMEOUT)],
                stdin=subprocess.PIPE,  # whenever this process ends, the pipe is closed
                stdout=subprocess.DEVNULL,
                pass_fds=[child_end.fileno()],
                env={"RUST_LOG": "off"} | os.environ | {"RERUN": "on"},  # the other process prints its own messages
            )
        self._thread = own(threading.Thread(target=self._run, name="live viewer", daemon=True))
        self._thread.start()

    def final_metadata(self) -> dict[str, str]:
        """Return metadata about the viewer, for the end of the file."""
        return {"viewer_dropped": str(self._queue.dropped)}

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Queue a record."""
        self._records += 1
        self._queue.put((topic, payload), transient=is_transient(record))

    def attach(self, asset: AssetFile) -> None:
        """Queue a file."""
        self._queue.put(asset, transient=False)

    def close(self) -> None:
        """End when the viewer has all records, or after a timeout."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._queue.close()
        started = self._started + _START_TIMEOUTS[self._target.kind] - time.monotonic()
        settled = self._settled.wait(max(_END_TIMEOUT, started))
        behind = not settled and self._hand_over()
        served = self._target.kind is ViewerKind.SERVE
        if served and (behind or settled) and self._process.poll() is None:
            atexit.register(_stop, self._process, os.getpid())
        elif not behind:
            _stop(self._process)  # wakes a thread that waits
        self._thread.join()
        self._connection.close()
        missed = self._records - self._taken
        if missed:
            count = f"{missed} of {self._records} records"
            time_left = "until its server ends" if served else f"{_LINGER_TIMEOUT:.0f} s"
            late = f"the viewer is {count} behind, and has {time_left} to catch up"
            text = late if behind else f"the viewer missed {count}"
            print(f"recorder: {text}; the file contains all records", file=sys.stderr)

    def _hand_over(self) -> bool:
        """Send the remaining items to the other process, and wake the thread. Return whether the process took them."""

        def send() -> None:
            with self._sending, contextlib.suppress(OSError):
                self._connection.send(self._queue.take_rest())
                self._connection.send([])

        sender = own(threading.Thread(target=send, name="rest for the viewer", daemon=True))
        sender.start()
        sender.join(_HAND_OVER_TIMEOUT)
        if sender.is_alive():  # the other process has stopped reading
            return False
        with socket.socket(fileno=os.dup(self._connection.fileno())) as ending:
            ending.shutdown(socket.SHUT_RD)
        if self._target.kind is ViewerKind.SERVE:  # pages can be opened until this process ends
            return self._process.poll() is None
        if self._process.stdin is not None:
            self._process.stdin.close()  # starts the timeout of the other process
        _lingering[:] = [process for process in (*_lingering, self._process) if process.poll() is None]
        return self._process in _lingering

    def _run(self) -> None:
        try:
            while self._connection.recv() is not Status.READY:
                self._settled.set()
            self._settled.clear()
            with unrecorded():  # if a finalizer prints in this thread, its text would wait for the queue
                while sent := self._send():
                    self._taken += self._connection.recv()
                    self._ended.wait(max(_BATCH_PERIOD, time.monotonic() - sent))  # the thread uses at most half a core
            self._connection.recv()
        except (EOFError, OSError):  # the other process has ended
            self._queue.take_rest()
        finally:
            self._settled.set()

    def _send(self) -> float | None:
        """Send the next batch, and return the time of sending; None for the empty batch at the end."""
        with self._sending:  # this batch must be sent before the remaining records
            batch = self._queue.take(_MAX_ITEMS, _MAX_BYTES)
            started = time.monotonic()
            self._connection.send(batch)
        return started if batch else None

    def wait(self) -> None:
        """Wait until the server of the page ends, or for Ctrl-C."""
        self._process.wait()


def _stop(process: subprocess.Popen[bytes], owner: int | None = None) -> None:
    if owner not in (None, os.getpid()):  # in a forked child, the parent owns the viewer
        return
    with process:  # at the end of the block, the process must end, and the pipe is closed
        process.kill()


Item: TypeAlias = tuple[str, bytes] | AssetFile  # a record's topic and payload, or a file

_TRANSIENT: Final = frozenset({"move_body", "move_joints", "simulate", "set_realtime"})
_OVERHEAD: Final = 200  # approximate size in bytes of an item in Python's memory


class LiveQueue:
    """A queue with a limited number of items and bytes. Writers never wait.

    A full queue first drops the oldest transient items: motions (the next keyframe contains the poses), events, fluents
    and output. Models, tasks and the contents of worlds are dropped last.
    """

    def __init__(self, max_items: int = 20_000, max_bytes: int = 128 << 20) -> None:
        self._max_items = max_items
        self._max_bytes = max_bytes
        self._items: OrderedDict[int, Item] = OrderedDict()
        self._transient: deque[int] = deque()  # keys of transient items, the oldest first
        self._count = 0
        self._changed = threading.Condition()
        self._closed = False
        self.size = 0  # number of bytes of all items
        self.dropped = 0  # number of dropped records

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item, *, transient: bool) -> None:
        """Append an item; if the queue is full, drop other items. Do nothing if the queue is closed."""
        with self._changed:
            if self._closed:
                return
            if transient:
                self._transient.append(self._count)
            self._items[self._count] = item
            self._count += 1
            self.size += _cost(item)
            while self._items and (len(self._items) > self._max_items or self.size > self._max_bytes):
                lost = self._pop(self._transient[0] if self._transient else next(iter(self._items)))
                self.dropped += isinstance(lost, tuple)
            self._changed.notify()

    def take(self, max_items: int, max_bytes: int) -> list[Item]:
        """Wait for items, and take the oldest items up to the limits. A closed and empty queue returns no items."""
        taken: list[Item] = []
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed)
            size = 0
            while self._items and len(taken) < max_items and size < max_bytes:
                taken.append(self._pop(next(iter(self._items))))
                size += _cost(taken[-1])
        return taken

    def take_rest(self) -> list[Item]:
        """Close the queue, and take all items."""
        with self._changed:
            taken = list(self._items.values())
            self._items.clear()
            self._transient.clear()
            self.size = 0
            self.close()
        return taken

    def close(self) -> None:
        """Close the queue; callers can still take items."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _pop(self, key: int) -> Item:
        item = self._items.pop(key)
        if self._transient and self._transient[0] == key:
            self._transient.popleft()
        self.size -= _cost(item)
        return item


def is_transient(record: Record) -> bool:
    """Return whether later records replace this record in the view."""
    if isinstance(record, Mutation):
        return record.WhichOneof("command") in _TRANSIENT
    return isinstance(record, Event | Fluent | Output)


def _cost(item: Item) -> int:
    return _OVERHEAD + len(item.content if isinstance(item, AssetFile) else item[1])


_TYPES: Final = {topic: kind for kind, topic in TOPICS.items()}
_STDERR: Final = 2
_CALL_TIMEOUT: Final = 1.0  # time in s for a call of the viewer's library


class Status(Enum):
    """The state of the viewer that the separate process reports."""

    ABSENT = "absent"
    READY = "ready"


def main(arguments: list[str]) -> None:
    """Translate a recording for a viewer until the recording's end, in a separate process.

    The arguments are the socket's descriptor, the target, the recording's title, and the time in s for a late viewer.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C must stop only the plan; a new session would undo nice()
    connection = Connection(int(arguments[0]))
    target = Target.parse(arguments[1])
    absent = threading.Event()
    threading.Thread(target=_end_with_parent, args=[absent, float(arguments[3])], name="parent", daemon=True).start()
    status = 1
    try:
        _serve(_Batches(connection), target, arguments[2], absent)
        status = 0
    except (ViewerGone, EOFError, OSError) as end:
        if str(end):
            _print(f"{end}; the plan continues without a viewer")
    finally:
        if sys.exception() is not None:
            traceback.print_exc()
        sys.stderr.flush()
        os._exit(status)  # the library's own exit might wait for the viewer forever


def _print(text: str) -> None:
    print(f"recorder: {text}", file=sys.stderr, flush=True)


def _end_with_parent(absent: threading.Event, linger: float) -> None:
    """End this process after the recording's process has closed the pipe; with a viewer, ``linger`` seconds later."""
    sys.stdin.buffer.read()
    sys.stderr.flush()
    os.dup2(os.open(os.devnull, os.O_WRONLY), _STDERR)
    absent.wait(linger)
    os._exit(1)


class _Batches:
    """The batches of the recording. Batches are read in a thread, so a slow viewer doesn't delay the recording."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._queue: queue.SimpleQueue[list[Item]] = queue.SimpleQueue()
        threading.Thread(target=self._read, name="batches", daemon=True).start()

    def _read(self) -> None:
        batch: list[Item] = [("", b"")]
        while batch:
            try:
                batch = self._connection.recv()
            except (EOFError, OSError):  # the process of the recording was killed
                batch = []
            self._queue.put(batch)

    def __iter__(self) -> Iterator[list[Item]]:
        return iter(self._queue.get, [])

    def report(self, status: Status | int) -> None:
        """Send the viewer's status, or the number of shown records of a batch, unless the recording has ended."""
        with contextlib.suppress(OSError):
            self._connection.send(status)


def _serve(batches: _Batches, target: Target, title: str, absent: threading.Event) -> None:
    # imported here: loading the library takes longer than a short plan
    import rerun as rr  # noqa: PLC0415

    from recorder.viewer.rerun_stream import APPLICATION  # noqa: PLC0415
    from recorder.viewer.translator import Translator  # noqa: PLC0415
    from recorder.viewer.web_page import WebPage  # noqa: PLC0415

    page: WebPage | None = None
    window: ViewerWindow | None = None
    stream = rr.RecordingStream(APPLICATION)
    stream.send_recording_name(title)
    if target.kind is ViewerKind.SERVE:
        absent.set()  # the pages end when the plan ends
        page = WebPage(stream)
        _print(f"live at {page.address}")
    else:
        url = target.url
        if target.kind is ViewerKind.SPAWN:
            window = ViewerWindow()
            url = window.url
        elif not answers(url):
            absent.set()
            batches.report(Status.ABSENT)
            _print(f"no viewer answers at {url} yet; to start a viewer at any time, run: rerun")
            wait_for_answer(url)
            absent.clear()
        stream.set_sinks(rr.GrpcSink(url))
    translator = Translator(stream)
    display = _Display(stream, translator)
    display.lay_out()
    batches.report(Status.READY)
    for batch in batches:
        shown = display.show(batch)
        display.lay_out()
        if page is not None:
            page.flush()
        else:
            _deliver(stream, window)
        batches.report(shown)
    translator.finish()
    display.lay_out()
    if page is not None:
        page.flush()
        batches.report(0)
        threading.Event().wait()  # the page is served until the process of the plan ends
    stream.disconnect()  # this waits until the viewer has all records
    batches.report(0)


class _Display:
    """Translates batches; records that can't be shown are skipped, and the first error is reported."""

    def __init__(self, stream: rr.RecordingStream, translator: Translator) -> None:
        self._stream = stream
        self._translator = translator
        self._laid_out = -1  # number of worlds in the layout; -1 if no layout was sent
        self._reported = False

    def lay_out(self) -> None:
        """Send the layout at the beginning, and whenever a plan begins to act in another world."""
        from recorder.viewer.translator import blueprint  # noqa: PLC0415

        worlds = self._translator.worlds
        if len(worlds.centres) > self._laid_out:
            self._laid_out = len(worlds.centres)
            self._stream.send_blueprint(blueprint(self._translator.layout(worlds.front)))

    def show(self, batch: list[Item]) -> int:
        """Translate a batch, and return the number of shown records."""
        shown = 0
        for item in batch:
            with self._skipping_errors():
                if isinstance(item, tuple):
                    topic, payload = item
                    self._translator.show(_TYPES[topic].FromString(payload))
                    shown += 1
                else:
                    self._translator.attach(item)
        with self._skipping_errors():
            self._translator.flush()
        return shown

    @contextlib.contextmanager
    def _skipping_errors(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # noqa: BLE001  records contain values of users, which may cause any error
            if not self._reported:
                _print(f"a record can't be shown ({error!r}); the file contains the record")
            self._reported = True


def _deliver(stream: rr.RecordingStream, window: ViewerWindow | None) -> None:
    """Wait without a time limit until the viewer has taken all rows. Raise ViewerGone if the viewer has ended."""
    while True:
        try:
            stream.flush(timeout_sec=_CALL_TIMEOUT)
        except RuntimeError as error:  # the library raises RuntimeError for every error
            broken = "timed out" not in str(error)
            if window is not None:
                window.check(END_TIMEOUT if broken else 0.0)
            if broken:
                raise ViewerGone("the viewer was closed") from error
        else:
            return
