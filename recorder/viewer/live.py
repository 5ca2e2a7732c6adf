"""Shows a recording live in a Rerun viewer; a viewer that is slow, stalls, dies or is missing costs the plan nothing.

Records go into a bounded queue (:class:`LiveQueue`). A thread sends them in batches to a process of its own
(:func:`main`) that translates them for the viewer, and sends the next batch when the viewer has taken one. When the
recording ends, the viewer gets a moment to take the rest. Then the process gets the rest, and some time to deliver it,
even if it is still loading the viewer's library. Records that the viewer did not get are counted and reported.

Whatever a viewer does to its clients, it does to that process: stall it, fill its memory, hang its exit. On the socket
the process may send ``Status.ABSENT``, then ``Status.READY`` when there is a viewer, and then how many records of each
batch the viewer took, without those that can't be shown. The recording sends batch after batch, lists of topics with
payloads and of files, and an empty one at the end.
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
from enum import Enum
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import TOPICS, Event, Fluent, Mutation, Output
from recorder.records.values import AssetFile
from recorder.tracing.forking import own
from recorder.tracing.journal import unrecorded
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
    from collections.abc import Iterator

    import rerun as rr

    from recorder.records import Record
    from recorder.viewer.translator import Translator


_END_TIMEOUT: Final = 1.8  # s for the viewer to take what is left
_START_TIMEOUTS: Final = {
    ViewerKind.SPAWN: 5.0,
    ViewerKind.CONNECT: 3.0,
    ViewerKind.SERVE: 3.0,
}  # s, for plans that are shorter
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
from recorder.viewer.live import main
main(sys.argv[1:])
"""


_lingering: Final[list[subprocess.Popen[bytes]]] = []  # processes that deliver the rest


class RerunSink:
    """A sink that is a viewer: "spawn", "connect", "connect:URL", "serve" or a URL; else it raises RecordingError."""

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
            self._process = subprocess.Popen(  # noqa: S603  our own code
                [sys.executable, "-c", _CODE, _ROOT, str(child_end.fileno()), live, title, str(_LINGER_TIMEOUT)],
                stdin=subprocess.PIPE,  # which is closed when this process ends, however it ends
                stdout=subprocess.DEVNULL,
                pass_fds=[child_end.fileno()],
                env={"RUST_LOG": "off"} | os.environ | {"RERUN": "on"},  # the process prints what matters
            )
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
        served = self._target.kind is ViewerKind.SERVE
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

        def send() -> None:
            with self._sending, contextlib.suppress(OSError):
                self._connection.send(self._queue.take_rest())
                self._connection.send([])

        sender = own(threading.Thread(target=send, name="rest for the viewer", daemon=True))
        sender.start()
        sender.join(_HAND_OVER_TIMEOUT)
        if sender.is_alive():  # the process doesn't read any more
            return False
        with socket.socket(fileno=os.dup(self._connection.fileno())) as ending:
            ending.shutdown(socket.SHUT_RD)
        if self._target.kind is ViewerKind.SERVE:  # pages have until this process ends
            return self._process.poll() is None
        if self._process.stdin is not None:
            self._process.stdin.close()  # its timeout begins
        _lingering[:] = [process for process in (*_lingering, self._process) if process.poll() is None]
        return self._process in _lingering

    def _run(self) -> None:
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


Item: TypeAlias = tuple[str, bytes] | AssetFile
"""A record's topic and payload, or a file."""

_TRANSIENT: Final = frozenset({"move_body", "move_joints", "simulate", "set_realtime"})
_OVERHEAD: Final = 200  # bytes of an item in Python, about


class LiveQueue:
    """A queue that never makes its writer wait, bounded in number and bytes.

    When it is full, the oldest transient items are dropped first, which later records make up for: motions of bodies
    and simulations (the next keyframe has the poses), events, fluents and output. Models, tasks and the contents of
    worlds are dropped only when nothing else is left.
    """

    def __init__(self, max_items: int = 20_000, max_bytes: int = 128 << 20) -> None:
        self._max_items = max_items
        self._max_bytes = max_bytes
        self._items: OrderedDict[int, Item] = OrderedDict()
        self._transient: deque[int] = deque()  # keys of the items that are dropped first, oldest first
        self._count = 0
        self._changed = threading.Condition()
        self._closed = False
        self.size = 0  # bytes of all items
        self.dropped = 0  # number of records that were dropped

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item, *, transient: bool) -> None:
        """Appends an item, and drops others if there are too many; does nothing after the end."""
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
        """Waits for items, and takes the oldest until they have so many bytes; none when it has ended and is empty."""
        taken: list[Item] = []
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed)
            size = 0
            while self._items and len(taken) < max_items and size < max_bytes:
                taken.append(self._pop(next(iter(self._items))))
                size += _cost(taken[-1])
        return taken

    def take_rest(self) -> list[Item]:
        """Ends it, and removes all items at once."""
        with self._changed:
            taken = list(self._items.values())
            self._items.clear()
            self._transient.clear()
            self.size = 0
            self.close()
        return taken

    def close(self) -> None:
        """Ends it; items can still be taken."""
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
    """Whether later records make up for this one."""
    if isinstance(record, Mutation):
        return record.WhichOneof("command") in _TRANSIENT
    return isinstance(record, Event | Fluent | Output)


def _cost(item: Item) -> int:
    return _OVERHEAD + len(item.content if isinstance(item, AssetFile) else item[1])


_TYPES: Final = {topic: kind for kind, topic in TOPICS.items()}
_STDERR: Final = 2
_CALL_TIMEOUT: Final = 1.0  # s, of one call of the viewer's library


class Status(Enum):
    """State of the viewer, as this process reports it to the recording."""

    ABSENT = "absent"
    READY = "ready"


def main(arguments: list[str]) -> None:
    """Serve one recording to its end, in a process of its own.

    Args:
        arguments: the socket's descriptor, the target, the recording's title, and the seconds after its end that a late
            viewer has.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the plan; a session of its own would undo the niceness
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
            _print(f"{end}; the plan goes on without")
    finally:
        if sys.exception() is not None:
            traceback.print_exc()
        sys.stderr.flush()
        os._exit(status)  # the viewer's library would wait for its viewer, perhaps for ever


def _print(text: str) -> None:
    print(f"recorder: {text}", file=sys.stderr, flush=True)


def _end_with_parent(absent: threading.Event, linger: float) -> None:
    """End ``linger`` seconds after the recording, whose end of this pipe closes however its process ends.

    By then all records are here, and nobody waits. Without a viewer this process ends immediately.
    """
    sys.stdin.buffer.read()
    sys.stderr.flush()
    os.dup2(os.open(os.devnull, os.O_WRONLY), _STDERR)
    absent.wait(linger)
    os._exit(1)


class _Batches:
    """Batches of the recording: read at once, however slow the viewer is."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._queue: queue.SimpleQueue[list[Item]] = queue.SimpleQueue()
        threading.Thread(target=self._read, name="batches", daemon=True).start()

    def _read(self) -> None:
        batch: list[Item] = [("", b"")]
        while batch:
            try:
                batch = self._connection.recv()
            except (EOFError, OSError):  # the recording was killed
                batch = []
            self._queue.put(batch)

    def __iter__(self) -> Iterator[list[Item]]:
        return iter(self._queue.get, [])

    def report(self, status: Status | int) -> None:
        """Sends the viewer's status, or how many records of a batch it took, if the recording still listens."""
        with contextlib.suppress(OSError):
            self._connection.send(status)


def _serve(batches: _Batches, target: Target, title: str, absent: threading.Event) -> None:
    # takes longer to load than a short plan, whose records are read meanwhile
    import rerun as rr  # noqa: PLC0415

    from recorder.viewer.rerun_stream import APPLICATION  # noqa: PLC0415
    from recorder.viewer.translator import Translator  # noqa: PLC0415
    from recorder.viewer.web_page import WebPage  # noqa: PLC0415

    page: WebPage | None = None
    window: ViewerWindow | None = None
    stream = rr.RecordingStream(APPLICATION)
    stream.send_recording_name(title)
    if target.kind is ViewerKind.SERVE:
        absent.set()  # pages end with the plan
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
            _print(f"no viewer at {url} yet; it can be started at any time: rerun")
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
        threading.Event().wait()  # the page is there until the process of the plan ends
    stream.disconnect()  # waits until the viewer has all
    batches.report(0)


class _Display:
    """Translates batches; skips what can't be shown, and reports that once."""

    def __init__(self, stream: rr.RecordingStream, translator: Translator) -> None:
        self._stream = stream
        self._translator = translator
        self._laid_out = -1  # number of worlds
        self._reported = False

    def lay_out(self) -> None:
        """Sends the layout: at the beginning, and again when a plan begins to act in another world."""
        from recorder.viewer.translator import blueprint  # noqa: PLC0415

        worlds = self._translator.worlds
        if len(worlds.centres) > self._laid_out:
            self._laid_out = len(worlds.centres)
            self._stream.send_blueprint(blueprint(worlds.centres, worlds.front))

    def show(self, batch: list[Item]) -> int:
        """Translates a batch, and returns how many records of it are shown."""
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
        except Exception as error:  # noqa: BLE001  users' own values are in records
            if not self._reported:
                _print(f"something can't be shown ({error!r}); the file has it")
            self._reported = True


def _deliver(stream: rr.RecordingStream, window: ViewerWindow | None) -> None:
    """Wait until the viewer has taken everything, however long that takes; raise :class:`ViewerGone` if it won't."""
    while True:
        try:
            stream.flush(timeout_sec=_CALL_TIMEOUT)
        except RuntimeError as error:  # the library has one type for all
            broken = "timed out" not in str(error)
            if window is not None:
                window.check(END_TIMEOUT if broken else 0.0)
            if broken:
                raise ViewerGone("the viewer was closed") from error
        else:
            return
