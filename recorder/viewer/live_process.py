"""The process between a recording and its viewer: translates records and sends them on.

Whatever a viewer does to its clients, it does to this process: stall it, fill its memory, hang its exit. The recording
(:mod:`recorder.viewer.live_sink`) sends a batch and continues when the viewer has taken it. At its end it sends all
that is left, and this process has some time to deliver that, also if it was still loading the viewer's library by then.
That and translating cost the plan nothing either, but for the core that they run on.

On the socket between them this side sends ``Status.ABSENT`` perhaps, ``Status.READY`` when there is a viewer, and then
how many records of each batch the viewer took; one that can't be shown is not counted. The other side sends batch after
batch, lists of topics with payloads and of files, and an empty one at the end.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import sys
import threading
import traceback
from enum import Enum
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Final

from recorder.records import TOPICS
from recorder.viewer.address import Kind, Target, ViewerGone, answers, wait_for_answer
from recorder.viewer.viewer_window import END_TIMEOUT, ViewerWindow

if TYPE_CHECKING:
    from collections.abc import Iterator

    import rerun as rr

    from recorder.viewer.live_queue import Item
    from recorder.viewer.translator import Translator

_TYPES: Final = {topic: kind for kind, topic in TOPICS.items()}
_STDERR: Final = 2
_CALL_TIMEOUT: Final = 1.0  # s, of one call of the viewer's library


class Status(Enum):
    """State of the viewer, as this process reports it to the recording."""

    ABSENT = "absent"
    READY = "ready"


def main(arguments: list[str]) -> None:
    """Serves one recording to its end.

    Args:
        arguments: the socket's descriptor, the target, the recording's title, and how many seconds after its end a
            viewer that is behind has.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the plan; a session of its own would undo the niceness
    connection = Connection(int(arguments[0]))
    target = Target.parse(arguments[1])
    absent = threading.Event()
    threading.Thread(target=_end_with_parent, args=[absent, float(arguments[3])], name="parent", daemon=True).start()
    status = 0
    try:
        _serve(_Batches(connection), target, arguments[2], absent)
    except (ViewerGone, EOFError, OSError) as end:
        if str(end):
            _print(f"{end}; the plan goes on without")
        status = 1
    except BaseException:  # noqa: BLE001  printed, and then it ends
        traceback.print_exc()
        status = 1
    finally:
        sys.stderr.flush()
        os._exit(status)  # the viewer's library would wait for its viewer, perhaps for ever


def _print(text: str) -> None:
    print(f"recorder: {text}", file=sys.stderr, flush=True)


def _end_with_parent(absent: threading.Event, linger: float) -> None:
    """Ends ``linger`` seconds after the recording, whose end of this pipe closes however its process ends.

    All is here then. Nobody who waits for the plan waits for that. Where no viewer is, it ends at once.
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
    if target.kind is Kind.SERVE:
        absent.set()  # pages end with the plan
        page = WebPage(stream)
        _print(f"live at {page.address}")
    else:
        url = target.url
        if target.kind is Kind.SPAWN:
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
        from recorder.viewer.blueprint import blueprint  # noqa: PLC0415

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
    """Waits until the viewer has taken what was sent, however long that takes.

    Raises:
        ViewerGone: it never will.
    """
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
