"""Recordings in the Rerun viewer: translated into an ``.rrd`` that is kept beside the recording, and opened.

The same code translates as while the plan runs (:mod:`recorder.viewer`): both show the same. An ``.rrd`` is a cache:
viewers of other versions may not read it, so it is made again when the recording or the software is newer.
"""

from __future__ import annotations

import contextlib
import gc
import os
import re
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

import rerun as rr
from rerun.experimental import ViewerClient

import recorder.viewer
from recorder.errors import RecordingError
from recorder.viewer.address import PORT, Kind, Target, ViewerGone, address, answers
from recorder.viewer.rerun_stream import stream_to_file
from recorder.viewer.viewer_window import END_TIMEOUT, ViewerWindow
from replay.errors import ReplayError
from replay.view.translation import front_world, translate

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from replay.file.record_reader import RecordReader

_LOAD_TIMEOUT: Final = 20.0  # s for the viewer to load a file
_POLL_PERIOD: Final = 0.1  # s
_MAGIC: Final = 4  # bytes at the beginning of an .rrd, before the release that wrote it
_HEADER: Final = 7


def convert(logs: Sequence[RecordReader], path: Path, at: int | None = None) -> None:
    """Writes recordings into one ``.rrd`` file; a file that is there is replaced when all is written.

    Several are shown side by side. The step ``at`` is looked at first, by default the beginning.

    Raises:
        ReplayError: it can't be written.
        Damaged: a record makes no sense.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".rrd", dir=path.parent)
    except OSError as error:
        raise ReplayError(f"{path}: can't be written: {error.strerror or error}") from error
    os.close(handle)
    try:
        with stream_to_file(Path(name)) as stream, _without_garbage_collection():
            translate(logs, stream, at)
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except OSError as error:
        raise ReplayError(f"{path}: can't be written: {error.strerror or error}") from error
    finally:
        Path(name).unlink(missing_ok=True)


@contextlib.contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Rows live until they are sent: the garbage collector would walk over them in vain."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def cached(log: RecordReader, at: int | None = None) -> Path:
    """The file of a recording for the viewer, kept beside it as ``NAME.mcap.rrd``; made if it isn't there or is older.

    It is a temporary file where beside the recording nothing can be written, and where the step that is looked at
    first is of another world than the beginning.

    Raises:
        Damaged: a record makes no sense.
    """
    if at is not None and front_world(log, at) != front_world(log):
        file = temporary_file(f"{log.path.name}.rrd")
        convert([log], file, at)
        return file
    beside = log.path.with_name(f"{log.path.name}.rrd")
    software = max(file.stat().st_mtime_ns for file in _sources())
    newer = beside.exists() and beside.stat().st_mtime_ns > max(log.path.stat().st_mtime_ns, software)
    if newer and _is_of_this_release(beside):
        return beside
    if not os.access(log.path.parent, os.W_OK):
        beside = temporary_file(beside.name)
    problems = log.problems
    convert([log], beside)
    made_ns = max(log.written_ns, software) + 1  # a running plan goes on writing what isn't in there
    if log.problems != problems:
        made_ns = 0  # damage was found while converting: it is to be reported each time
    os.utime(beside, ns=(made_ns, made_ns))
    return beside


def temporary_file(name: str) -> Path:
    """A file in the user's own folder for temporary files.

    Nobody can replace another user's file there, and several users view the same recordings.

    Raises:
        ReplayError: there can't be such a folder.
    """
    folder = Path(tempfile.gettempdir()) / f"pycram-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise ReplayError(f"{folder}: can't be made: {error.strerror or error}") from error
    return folder / name


def _is_of_this_release(file: Path) -> bool:
    """Whether this release of the viewer's library wrote a file; another one may not read it."""
    with file.open("rb") as opened:
        written = opened.read(_HEADER)[_MAGIC:]
    return [*written] == [int(part) for part in re.findall(r"\d+", rr.__version__)[: _HEADER - _MAGIC]]


def _sources() -> Iterator[Path]:
    """Code that an ``.rrd`` depends on."""
    yield Path(rr.__file__)
    yield from Path(recorder.viewer.__file__).parent.glob("*.py")


def check(url: str | None) -> None:
    """Checks the address of a viewer; None is any.

    Raises:
        ReplayError: it isn't an address, or nothing answers there.
    """
    if url is None:
        return
    try:
        viewer = Target.parse(f"{Kind.CONNECT.value}:{url}").url
    except RecordingError as error:
        raise ReplayError(f"{url} is no address of a viewer; one on this machine is {address(PORT)}") from error
    if not answers(viewer):
        raise ReplayError(f"no viewer answers at {url}; start one: rerun")


def _go_to(client: ViewerClient, step: int) -> None:
    """Sets the viewer's time to a step, as soon as it has loaded something."""
    pause, until = threading.Event(), time.monotonic() + _LOAD_TIMEOUT
    while True:
        try:
            client.set_time("step", sequence=step, play_state="paused")
        except (RuntimeError, OSError):
            if time.monotonic() > until:
                raise
            pause.wait(_POLL_PERIOD)
        else:
            return


def show(path: Path, step: int | None = None, url: str | None = None) -> str:
    """Opens an ``.rrd`` file at a step in a viewer, and returns the viewer's address.

    That is the one at ``url``, else one that is open on this machine, else a new one, which outlives this process.

    Raises:
        ReplayError: no viewer answers there, or none can be started.
    """
    check(url)
    try:
        window = None if url else ViewerWindow()
        viewer = window.url if window else str(url)
        try:
            client = ViewerClient.connect(viewer)
            client.open(str(path.resolve()))
            if step is not None:
                _go_to(client, step)
        except (RuntimeError, OSError) as error:
            if window:
                window.check(END_TIMEOUT)
            raise ReplayError(f"{path} can't be shown: {error}") from error
    except ViewerGone as error:
        raise ReplayError(f"{error}; without a screen, use --web or --save FILE") from error
    return viewer
