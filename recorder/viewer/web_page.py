"""A web page that shows the viewer in browsers of this machine, to the user who has its address.

It works without a network, and where there is one it contacts nobody there: what the viewer's page gets from elsewhere,
a font and examples, is left out, and a policy forbids other connections than to its own server
(:mod:`recorder.viewer.page_server`). Records reach the page as one file that grows.
"""

from __future__ import annotations

import contextlib
import html
import os
import re
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import quote

import rerun as rr

from recorder.viewer.address import ViewerGone, free_port
from recorder.viewer.page_server import INDEX, RECORDS, PageServer
from recorder.viewer.viewer_files import read_viewer_files

if TYPE_CHECKING:
    from collections.abc import Iterator

_PORT: Final = 9090  # of pages
_MAX_TRIES: Final = 5  # for a free port
_START_TIMEOUT: Final = 5.0  # s for the file to be written
_PIECE: Final = 1 << 20  # bytes that are sent at once
_FOREIGN_LINK: Final = re.compile(rb'<link[^>]*href="https?://[^>]*>')


class WebPage:
    """Serves what a stream gets, and the viewer as a page, while this process lives.

    Pages that are opened late get everything from the beginning.

    Attributes:
        address: of the page; it holds a token, so only who knows it gets anything.

    Raises:
        ViewerGone: nothing can be served.
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        try:
            self._records = _GrowingFile(stream)
        except (OSError, RuntimeError) as error:  # the latter is the library's type for all errors
            raise ViewerGone(f"the page can't be served: {error}") from error
        server = self._serve()
        self.address = f"{server.address}?hide_welcome_screen&url={quote(server.address + RECORDS, safe='')}"

    def _serve(self) -> PageServer:
        for _ in range(_MAX_TRIES):
            try:
                return PageServer(free_port(_PORT), _Files().read, self._records)
            except OSError:  # somebody has just taken it
                continue
        raise ViewerGone("the page can't be served: no port is free")

    def flush(self) -> None:
        """Sends the pages what the stream has got."""
        self._stream.flush()
        self._records.notify()


@contextlib.contextmanager
def private_link(address: str) -> Iterator[str]:
    """The address of a file that leads browsers to a page, until the end of the block.

    Other users see what programs are called with, as browsers are with what they open; they can't read this file.
    """
    with tempfile.NamedTemporaryFile("w", prefix="pycram-page-", suffix=".html") as file:  # for its owner only
        file.write(f'<!doctype html><meta http-equiv="refresh" content="0;url={html.escape(address)}">')
        file.flush()
        yield Path(file.name).as_uri()


class _Files:
    """The files of the page; read when a browser asks for the first, as many pages are never opened."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._files: dict[str, bytes] = {}

    def read(self) -> dict[str, bytes]:
        with self._lock:
            if not self._files:
                files = read_viewer_files()
                files[INDEX] = _FOREIGN_LINK.sub(b"", files[INDEX])
                self._files = files
            return self._files


class _GrowingFile:
    """What a stream gets, in a file without a name; see :class:`recorder.viewer.page_server.Records`."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._grown = threading.Condition()
        with tempfile.TemporaryDirectory(prefix="pycram-page-") as folder:
            file = Path(folder) / RECORDS
            stream.set_sinks(rr.FileSink(file))
            stream.flush(timeout_sec=_START_TIMEOUT)
            self._file = file.open("rb", buffering=0)

    def notify(self) -> None:
        """Wakes who waits for more."""
        with self._grown:
            self._grown.notify_all()

    def pieces(self) -> Iterator[bytes]:
        """All from the beginning, and then what comes."""
        at = 0
        while True:
            with self._grown:
                self._grown.wait_for(lambda at=at: os.fstat(self._file.fileno()).st_size > at)  # type: ignore[misc]
            piece = os.pread(self._file.fileno(), _PIECE, at)
            at += len(piece)
            yield piece
