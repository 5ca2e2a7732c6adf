"""Recordings in the Rerun viewer: translated into an ``.rrd`` that is kept beside the recording, and opened.

The same code translates as while the plan runs (:mod:`recorder.viewer`): both show the same. An ``.rrd`` is a cache:
viewers of other versions may not read it, so it is made anew when the recording or the software is newer.
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
from typing import TYPE_CHECKING, Any, Final

import rerun as rr
from rerun.experimental import ViewerClient

import recorder.viewer
from recorder.errors import RecordingError
from recorder.viewer.blueprint import ORIGIN, blueprint, side_by_side
from recorder.viewer.connection import PORT, Kind, Target, ViewerGone, address, answers
from recorder.viewer.scene_view import acts
from recorder.viewer.windows import open_window, stream_to_file
from replay.errors import ReplayError
from replay.view.translation import translated

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from recorder.geometry import Vector
    from replay.file.log import Log

_ALONE: Final = ""  # root of what isn't shown beside others
_TO_LOAD: Final = 20.0  # s for the viewer to load a file
_LOOK_AGAIN: Final = 0.1  # s
_MAGIC: Final = 4  # bytes at the beginning of an .rrd, before the release that wrote it
_HEADER: Final = 7


def convert(logs: Sequence[Log], path: Path, at: int | None = None) -> None:
    """Writes recordings as one for the viewer; what is there already is replaced when all is written.

    Args:
        logs: one recording, or several that are shown side by side.
        path: the ``.rrd`` file.
        at: the step that is looked at first; by default the beginning.

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
        with stream_to_file(Path(name)) as stream, _without_collecting():
            translate(logs, stream, at, path.parent)
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except OSError as error:
        raise ReplayError(f"{path}: can't be written: {error.strerror or error}") from error
    finally:
        Path(name).unlink(missing_ok=True)


@contextlib.contextmanager
def _without_collecting() -> Iterator[None]:
    """Rests the garbage collector: rows live until they are sent, and it would walk over them in vain."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def translate(
    logs: Sequence[Log], stream: rr.RecordingStream, at: int | None = None, folder: Path | None = None
) -> None:
    """Sends recordings to where the viewer gets its data from.

    Args:
        logs: one recording, or several that are shown side by side.
        stream: where they go.
        at: the step that is looked at first; by default the beginning.
        folder: where there is room for half of it; by default that for temporary files.

    Raises:
        Damaged: a record makes no sense.
        OSError: there is no room.
    """
    stream.send_recording_name(_title(logs))
    roots = _roots(logs)
    fronts = {root: _front(log, at) for root, log in zip(roots, logs, strict=True)}
    _lay_out(stream, {root: {front: ORIGIN} if front else {} for root, front in fronts.items()}, fronts)
    worlds = {root: translated(log, stream, root, folder).worlds for root, log in zip(roots, logs, strict=True)}
    _lay_out(stream, worlds, fronts)


def _lay_out(
    stream: rr.RecordingStream, recordings: Mapping[str, Mapping[str, Vector]], fronts: Mapping[str, str]
) -> None:
    if _ALONE in recordings:
        stream.send_blueprint(blueprint(recordings[_ALONE], fronts[_ALONE]))
    else:
        stream.send_blueprint(side_by_side(recordings, fronts))


def _front(log: Log, at: int | None = None) -> str:
    """The world that is looked at: that of a step, or by default the first that the plan does something in; "" if none.

    Steps without a world of their own are of that of the step before.
    """
    if at is None:
        return next((record.world for record in log if acts(record)), "")
    return next((record.world for record in log.backwards(min(at, len(log) - 1)) if record.world), "") or _front(log)


def _title(logs: Sequence[Log]) -> str:
    """The plan's name, as while it ran; those of the files where plans are compared."""
    if len(logs) == 1:
        return logs[0].metadata.get("plan", logs[0].path.name)
    return " and ".join(log.path.name for log in logs)


def _roots(logs: Sequence[Log]) -> list[str]:
    """Names for recordings that are shown side by side: those of their files, if these are different."""
    if len(logs) == 1:
        return [_ALONE]
    names = [log.path.stem for log in logs]
    return names if len(set(names)) == len(names) else [f"{number}_{name}" for number, name in enumerate(names, 1)]


def cached(log: Log, at: int | None = None) -> Path:
    """A recording for the viewer, kept beside it as ``NAME.mcap.rrd``; made if it isn't there or is older.

    Args:
        log: the recording.
        at: the step that is looked at first; by default the beginning.

    Returns:
        The file; in the folder for temporary files where beside the recording nothing can be written, and where the
        step is of another world than the beginning.

    Raises:
        Damaged: a record makes no sense.
    """
    if at is not None and _front(log, at) != _front(log):
        file = unrecorded(f"{log.path.name}.rrd")
        convert([log], file, at)
        return file
    beside = log.path.with_name(f"{log.path.name}.rrd")
    software = max(file.stat().st_mtime_ns for file in _sources())
    newer = beside.exists() and beside.stat().st_mtime_ns > max(log.path.stat().st_mtime_ns, software)
    if newer and _is_of_this_release(beside):
        return beside
    if not os.access(log.path.parent, os.W_OK):
        beside = unrecorded(beside.name)
    missing = log.problems
    convert([log], beside)
    known = max(log.written_ns, software) + 1  # a running plan goes on writing what isn't in there
    if log.problems != missing:
        known = 0  # that something is damaged was found on the way: it is to be found, and said, each time
    os.utime(beside, ns=(known, known))
    return beside


def unrecorded(name: str) -> Path:
    """Where a file goes that isn't kept beside its recording: in the user's own folder among those for temporary files.

    Nobody can replace another user's file there, and several users view the same recordings.

    Args:
        name: of the file.

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
    """Whether the viewer's library wrote a file as it is now: one that was put in its place can have older files."""
    with file.open("rb") as opened:
        written = opened.read(_HEADER)[_MAGIC:]
    return [*written] == [int(part) for part in re.findall(r"\d+", rr.__version__)[: _HEADER - _MAGIC]]


def _sources() -> Iterator[Path]:
    """What an ``.rrd`` depends on, beside its recording."""
    yield Path(rr.__file__)
    yield from Path(recorder.viewer.__file__).parent.glob("*.py")


def check(url: str | None) -> None:
    """Makes sure that a viewer is where it is said to be.

    Args:
        url: its address; None if nothing was said.

    Raises:
        ReplayError: that isn't an address, or nothing answers there.
    """
    if url is None:
        return
    try:
        place = Target.parse(f"{Kind.CONNECT.value}:{url}").url
    except RecordingError as error:
        raise ReplayError(f"{url} is no address of a viewer; one on this machine is {address(PORT)}") from error
    if not answers(place):
        raise ReplayError(f"no viewer answers at {url}; start one: rerun")


def _go_to(client: ViewerClient, step: int) -> None:
    """Goes to a step as soon as the viewer has something to go in."""
    paused: dict[str, Any] = {"play_state": "paused"} if hasattr(client, "open") else {}  # older ones pause anyway
    pause, until = threading.Event(), time.monotonic() + _TO_LOAD
    while True:
        try:
            client.set_time("step", sequence=step, **paused)
        except (RuntimeError, OSError):
            if time.monotonic() > until:
                raise
            pause.wait(_LOOK_AGAIN)
        else:
            return


def show(path: Path, step: int | None = None, url: str | None = None) -> str:
    """Opens a file in a viewer: in one that is open already, else in a new one, which outlives this process.

    Args:
        path: the ``.rrd`` file.
        step: where to begin; by default at the beginning.
        url: address of the viewer; by default that of one on this machine.

    Returns:
        The viewer's address.

    Raises:
        ReplayError: no viewer answers there, or none can be started.
    """
    check(url)
    try:
        place = url or open_window()
        client = ViewerClient.connect(place)
        opening = getattr(client, "open", None) or client.open_url  # by version
        opening(str(path.resolve()))
        if step is not None:
            _go_to(client, step)
    except ViewerGone as error:
        raise ReplayError(f"{error}; without a screen, say --web or --save FILE") from error
    except (RuntimeError, OSError) as error:
        raise ReplayError(f"{path} can't be shown: {error}") from error
    return place
