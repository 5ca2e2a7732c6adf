"""Recordings in the Rerun viewer; it opens a translated copy, an ``.rrd`` file next to the recording.

The same code translates records also while a plan runs (:mod:`recorder.viewer`). An ``.rrd`` file is a cache, but other
users may be able to write in its folder. The file is therefore used only if this user made it from this recording with
this software: a folder of the user contains the hash of each ``.rrd`` file, under the hash of its inputs.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from hashlib import file_digest, sha256
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

import rerun as rr
from rerun.experimental import ViewerClient

import recorder.viewer
from recorder.errors import RecordingError
from recorder.geometry import Vector
from recorder.records import Check
from recorder.records.values import AssetFile
from recorder.system import cache_folder, is_own, user
from recorder.tracing.interrupts import partial_folder
from recorder.viewer.connection import END_TIMEOUT, PORT, Target, ViewerGone, ViewerKind, ViewerWindow, address, answers
from recorder.viewer.rerun_stream import STEP, stream_to_file
from recorder.viewer.translator import ORIGIN, Layout, Translator, acts, blueprint, side_by_side
from replay.compare import divergence
from replay.errors import NONSENSE, Damaged, ReplayError, nonsense
from replay.file.record_reader import RecordReader

if TYPE_CHECKING:
    Eye: TypeAlias = tuple[Vector, Vector] | None  # a viewpoint, and the middle of its picture, m; None for an overview

_LOAD_TIMEOUT: Final = 20.0  # time in s within which the viewer must load a file
_POLL_PERIOD: Final = 0.1  # seconds between checks


def convert(
    logs: Sequence[RecordReader], path: Path, at: int | None = None, eyes: Sequence[Eye] = (), *, opens: bool = False
) -> None:
    """Write recordings side by side into an ``.rrd`` file, which replaces an existing file when it is complete.

    :func:`translate` describes the arguments. If the file can't be written, ReplayError is raised; if a record makes no
    sense, Damaged is raised.
    """
    try:
        with partial_folder(path) as folder:
            part = folder / path.name
            with stream_to_file(part) as stream:
                translate(logs, stream, at, eyes, opens=opens)
            part.chmod(0o644)
            part.replace(path)
    except OSError as error:
        raise ReplayError(f"{path}: can't be written: {error.strerror or error}") from error


def cached(log: RecordReader, at: int | None = None, eye: Eye = None) -> Path:
    """Return the viewer's file of a recording, which is cached next to the recording as ``NAME.mcap.rrd``.

    If the folder isn't writable, or if another world is open at step ``at`` than at the beginning, the file is
    temporary. The errors are those of :func:`convert`.
    """
    if at is not None and front_world(log, at) != front_world(log):
        file = temporary_file(f"{log.path.name}.rrd")
        convert([log], file, at, [eye])
        return file
    beside = log.path.with_name(f"{log.path.name}.rrd")
    note = _note(log, eye)
    if note is not None:
        with contextlib.suppress(OSError, ValueError):  # the file or its note is missing
            if note.read_text(encoding="ascii") == _hash(beside):
                return beside
    if not os.access(log.path.parent, os.W_OK):
        beside = temporary_file(beside.name)
    problems = log.problems
    convert([log], beside, eyes=[eye])
    unchanged = log.path.stat().st_mtime_ns == log.written_ns  # a running plan still writes the recording
    if note is not None and unchanged and log.problems == problems:  # every call must report the damage
        with contextlib.suppress(OSError):
            note.parent.mkdir(parents=True, exist_ok=True)
            note.write_text(_hash(beside), encoding="ascii")
    return beside


def _note(log: RecordReader, eye: Eye) -> Path | None:
    """Return the file with the hash of a recording's ``.rrd`` file for this software; None without a cache."""
    folder = cache_folder()
    if folder is None:
        return None
    made_of = sha256(f"{rr.__version__} {_hash(log.path)} {eye}".encode())
    for source in sorted(Path(recorder.viewer.__file__).parent.glob("*.py")):
        made_of.update(source.read_bytes())
    return folder / "rrd" / made_of.hexdigest()


def _hash(file: Path) -> str:
    with file.open("rb") as opened:
        return file_digest(opened, "sha256").hexdigest()


def temporary_file(name: str) -> Path:
    """Return a path in the user's own folder for temporary files; raise ReplayError if this folder can't be used."""
    folder = Path(tempfile.gettempdir()) / f"pycram-{user()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise ReplayError(f"{folder}: can't be made: {error.strerror or error}") from error
    if folder.is_symlink() or not is_own(folder):
        raise ReplayError(
            f"{folder} isn't yours alone: other users can change its content; set TMPDIR to a folder of your own"
        )
    return folder / name


def check(url: str | None) -> None:
    """Raise ReplayError if ``url`` isn't the address of a viewer, or if no viewer answers. None means any viewer."""
    if url is None:
        return
    try:
        viewer = Target.parse(f"{ViewerKind.CONNECT.value}:{url}").url
    except RecordingError as error:
        raise ReplayError(
            f"{url} isn't the address of a viewer; a viewer on this machine has the address {address(PORT)}"
        ) from error
    if not answers(viewer):
        raise ReplayError(f"no viewer answers at {url}; to start one, run: rerun")


def _go_to(client: ViewerClient, step: int) -> None:
    """Set the viewer's time to a step. The viewer must have received data before."""
    pause, until = threading.Event(), time.monotonic() + _LOAD_TIMEOUT
    while True:
        try:
            client.set_time(STEP, sequence=step, play_state="paused")
        except (RuntimeError, OSError):
            if time.monotonic() > until:
                raise
            pause.wait(_POLL_PERIOD)
        else:
            return


def follow(log: RecordReader, step: int, url: str | None = None) -> tuple[str, Callable[[int], None]]:
    """Open a recording at a step, and return the viewer's address and a function that shows a step.

    If the user has closed the viewer, the function does nothing. The errors are those of :func:`show`.
    """
    viewer = show(cached(log, step), step, url)
    client = ViewerClient.connect(viewer)

    def go(to: int) -> None:
        with contextlib.suppress(RuntimeError, OSError):
            client.set_time(STEP, sequence=to, play_state="paused")

    return viewer, go


def show(path: Path, step: int | None = None, url: str | None = None) -> str:
    """Open an ``.rrd`` file at a step in a viewer, and return the viewer's address.

    The viewer is the viewer at ``url``, or else an open viewer on this machine, or else a new viewer. It stays open.

    Raises:
        ReplayError: no viewer answers at ``url``, or no viewer can be started.
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


_NO_ROOT: Final = ""  # root entity of a recording that is shown alone


def translate(
    logs: Sequence[RecordReader],
    stream: rr.RecordingStream,
    at: int | None = None,
    eyes: Sequence[Eye] = (),
    *,
    opens: bool = False,
) -> None:
    """Send recordings to a viewer, which shows them side by side; the world of the step ``at`` is in front.

    Args:
        eyes: The first viewpoint of each recording; None for an overview.
        opens: Whether the viewer opens at the step ``at``. The viewer then shows a time line that ends at this step.

    Raises:
        Damaged: a record makes no sense.
    """
    if len(logs) == 1:  # live views also have the plan's name
        stream.send_recording_name(logs[0].metadata.get("plan", logs[0].path.name))
    else:
        stream.send_recording_name(" and ".join(log.path.name for log in logs))
    roots = dict(zip(_roots(logs), logs, strict=True))
    fronts = {root: front_world(log, at) for root, log in roots.items()}
    until = at if opens else None
    _lay_out(stream, {root: Layout({front: ORIGIN} if front else {}, front) for root, front in fronts.items()}, until)
    views, partings = dict(zip_longest(roots, eyes)), _partings(roots)
    layouts = {}
    for root, log in roots.items():
        folds = any(life.looks for life in log.lifetimes) or next(log.records(Check), None) is not None
        translator = Translator(stream, root, folds=folds, until=until, partings=partings[root])
        _translate(log, translator)
        layouts[root] = translator.layout(fronts[root], views[root])
    _lay_out(stream, layouts, until)


def _partings(roots: Mapping[str, RecordReader]) -> dict[str, dict[int, list[str]]]:
    """Return, by root entity, the step at which each recording and the first recording begin to differ."""
    partings: dict[str, dict[int, list[str]]] = {root: {} for root in roots}
    (one, first), *others = roots.items()
    for other, second in others:
        if (found := divergence(first, second)) is not None:
            sides = (one, first, found.first, other), (other, second, found.second, one)
            for root, log, record, name in sides:  # after a run has ended, it differs from a longer run
                partings[root].setdefault(record.seq if record is not None else len(log) - 1, []).append(name)
    return partings


def front_world(log: RecordReader, at: int | None = None) -> str:
    """Return the world in front: the world of the last record up to a step, or else the first world with actions."""
    if at is not None:
        world = next((record.world for record in log.backwards(min(at, len(log) - 1)) if record.world), "")
        if world:
            return world
    return next((record.world for record in log if acts(record)), "")


def _roots(logs: Sequence[RecordReader]) -> list[str]:
    """Return the root entities of recordings side by side: the names of their files if these differ."""
    if len(logs) == 1:
        return [_NO_ROOT]
    names = [log.path.stem for log in logs]
    return names if len(set(names)) == len(names) else [f"{number}_{name}" for number, name in enumerate(names, 1)]


def _lay_out(stream: rr.RecordingStream, layouts: Mapping[str, Layout], until: int | None) -> None:
    single = layouts.get(_NO_ROOT)
    stream.send_blueprint(blueprint(single, until) if single is not None else side_by_side(layouts, until))


def _translate(log: RecordReader, translator: Translator) -> None:
    for name in log.assets:
        with _damage(log, f"the attached file {name}"), contextlib.suppress(Damaged):  # the recording notes the damage
            translator.attach(AssetFile(name.partition("/")[2], log.assets[name]))
    for record in log.records():
        try:  # this is faster than a context manager for each record
            translator.show(record)
        except NONSENSE as error:
            raise nonsense(log.path, f"step {record.seq}", error) from error
    with _damage(log, "a record"):  # a damaged record may contain too long a time
        translator.finish()
    for name in translator.scene.absent:  # filters of other tools may have removed attachments
        log.assets.damaged.setdefault(name, "it isn't there")


@contextlib.contextmanager
def _damage(log: RecordReader, where: str) -> Iterator[None]:
    try:
        yield
    except NONSENSE as error:
        raise nonsense(log.path, where, error) from error
