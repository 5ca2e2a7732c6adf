"""The process between a recording and its viewer: translates records and hands them over.

Whatever a viewer does to those who talk to it, it does to this process: stall it, fill its memory, hang its exit. The
recording (:mod:`recorder.rerun_sink`) sends a batch and goes on when the viewer has taken it, or doesn't; it kills this
process when it has waited long enough. Loading the viewer's library and translating cost the plan nothing either, but
for the core that they run on.

On the socket between them, this side says ``Word.ABSENT`` perhaps, ``Word.READY`` when there is a viewer, and then how
many records of each batch the viewer took. The other side sends batch after batch, lists of topics with payloads and of
files, and an empty one at the end.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
from multiprocessing.connection import Connection
from typing import IO, TYPE_CHECKING, Final
from urllib.parse import quote

import rerun as rr

from recorder.records import TOPICS
from recorder.viewer.translator import Translator
from recorder.viewers import HOST, PAGE_PORT, PORT, Kind, Wish, Word, address, answers, free_port

if TYPE_CHECKING:
    from recorder.backlog import Item

_KINDS: Final = {topic: kind for kind, topic in TOPICS.items()}
_NICE: Final = 5  # the plan goes first where cores are few
_LOOK_AGAIN: Final = 0.2  # s between two looks for a viewer
_LAST_WORDS: Final = 2.0  # s to hand over what is here when the plan's process was killed
_PATIENCE: Final = 1.0  # s that one call of the viewer's library may take


class ViewerGone(Exception):
    """The viewer has ended."""


def main(arguments: list[str]) -> None:
    """Serves one recording to its end.

    Args:
        arguments: the socket's descriptor, the wish, the recording's title.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the plan; a session of its own would undo the niceness
    connection = Connection(int(arguments[0]))
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    os.nice(_NICE)
    status = 0
    try:
        _serve(connection, Wish.parse(arguments[1]), arguments[2])
    except (ViewerGone, EOFError, OSError) as end:
        if str(end):
            print(f"recorder: {end}", file=sys.stderr)
        status = 1
    sys.stderr.flush()
    os._exit(status)  # the viewer's library would wait for its viewer, perhaps for ever


def _end_with_parent() -> None:
    """Ends soon after the parent, whose end of this pipe closes however it dies."""
    sys.stdin.buffer.read()
    threading.Event().wait(_LAST_WORDS)
    os._exit(1)


def _serve(connection: Connection, wish: Wish, title: str) -> None:
    stream = rr.RecordingStream(title)
    if wish.kind is Kind.SERVE:
        _open_page(stream)
    else:
        url = wish.url
        if wish.kind is Kind.SPAWN:
            url = _spawn()
        elif not answers(url):
            connection.send(Word.ABSENT)
            print(
                f"recorder: no viewer at {url} yet; it can be started at any time: rerun", file=sys.stderr, flush=True
            )
            _await(url)
        stream.set_sinks(rr.GrpcSink(url))
    translator = Translator(stream)
    connection.send(Word.READY)
    while batch := connection.recv():
        _show(translator, batch)
        _deliver(stream)
        connection.send(sum(isinstance(item, tuple) for item in batch))
    if wish.kind is Kind.SERVE:
        connection.send(0)
        threading.Event().wait()  # the page is there until the process of the plan ends
    stream.disconnect()  # waits until the viewer has all
    connection.send(0)


def _show(translator: Translator, batch: list[Item]) -> None:
    for item in batch:
        if isinstance(item, tuple):
            topic, payload = item
            translator.show(topic, _KINDS[topic].FromString(payload))
        else:
            translator.attach(item)
    translator.flush()


def _deliver(stream: rr.RecordingStream) -> None:
    """Waits until the viewer has taken what was sent, if it takes an hour.

    Raises:
        ViewerGone: it never will.
    """
    while True:
        try:
            stream.flush(timeout_sec=_PATIENCE)
        except RuntimeError as error:  # the library has one type for all
            if "timed out" not in str(error):
                raise ViewerGone("the viewer was closed; the plan goes on without") from error
        else:
            return


def _await(url: str) -> None:
    """Waits for a viewer that somebody starts."""
    pause = threading.Event()
    while not answers(url):
        pause.wait(_LOOK_AGAIN)


def _open_page(stream: rr.RecordingStream) -> None:
    """Serves the records, and the viewer as a page to see them with; says where.

    Both servers live in this process. Pages that are opened late get everything from the beginning.
    """
    port = free_port(PORT)
    stream.set_sinks(rr.GrpcServerSink(bind_ip=HOST, port=port))
    page = free_port(PAGE_PORT)
    rr.serve_web_viewer(web_port=page, open_browser=False, connect_to=address(port))
    place = f"http://{HOST}:{page}/?url={quote(address(port), safe='')}"
    print(f"recorder: live at {place}", file=sys.stderr, flush=True)


def _spawn() -> str:
    """Starts a viewer that outlives the plan, and waits until it is there; one that is open already is taken.

    Returns:
        Its address.

    Raises:
        ViewerGone: it ended at once, for example because there is no screen.
    """
    if answers(address(PORT)):
        return address(PORT)
    port = free_port(PORT)
    with tempfile.TemporaryFile() as said:
        viewer = subprocess.Popen(  # noqa: S603  the viewer that came with the library
            [sys.executable, "-m", "rerun_cli", "--port", str(port), "--bind", HOST, "--expect-data-soon"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,  # Ctrl-C is for the plan
            env=os.environ | {"RERUN_APP_ONLY": "true"},
        )
        pause = threading.Event()
        while not answers(address(port)):
            if viewer.poll() is not None:
                raise ViewerGone(f"the viewer didn't open ({_last_line(said)}); the plan goes on without")
            pause.wait(_LOOK_AGAIN)
    return address(port)


def _last_line(said: IO[bytes]) -> str:
    said.seek(0)
    lines = said.read().decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "it didn't say why")
