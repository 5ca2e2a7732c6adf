"""Write records into an MCAP file that survives the death of its process.

A killed process loses the records that aren't in a closed and flushed chunk. So a chunk is closed

- after 50 records, and 50 ms after its first record;
- immediately after a failure, and after the start or end of the run;
- before native code that blocks all threads (:meth:`McapSink.flush`).

A thread keeps the 50 ms, so they don't count while the process gets no processor, or while native code of the plan
holds the interpreter lock. The other rules hold always.

Chunks are handed to the operating system unbuffered. After that, only a failure of the computer can lose them. With
``durable``, such a failure can't lose them either.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import stat
import sys
import threading
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from recorder import system
from recorder.errors import RecordingError
from recorder.mcap_writer import MAGIC, MODELS_METADATA, McapWriter, SharedModels
from recorder.packages import versions
from recorder.records import TOPICS, Keyframe, Mutation, Query, Run, Task, escaped, format_number
from recorder.records.motion import FrameTree
from recorder.records.text import Lines
from recorder.tracing.forking import own
from recorder.tracing.journal import unrecorded

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from google.protobuf.message import Message

    from recorder.records import Record
    from recorder.records.values import AssetFile


_MAX_RECORDS: Final = 50  # largest number of records in a chunk
_MAX_BYTES: Final = 1 << 20  # largest number of bytes in a chunk
_FLUSH_PERIOD: Final = 0.05  # s
_Key: TypeAlias = tuple[
    str, str, int
]  # key of a channel: topic, world and the world's lifetime; "" and 0 for a channel of all worlds
#: A buffered message: key of its channel, number and time of its record, bytes. The record itself is the last item
#: if its log line is made when the chunk is closed.
_Buffered: TypeAlias = "tuple[_Key, int, int, bytes, Record | None]"
_LINES: Final = ("/log", "", 0)
_TRANSFORMS: Final = ("/tf", "", 0)
_FAILURES: Final = frozenset({Task.FAILED, Task.CANCELLED})
_PER_WORLD: Final = frozenset(TOPICS[kind] for kind in (Mutation, Keyframe))  # topics with a channel for each world
_MAX_CHANNELS: Final = 1000  # beyond this number, worlds share channels; MCAP allows 65,535


class McapSink:
    """A sink that is one MCAP file.

    Args:
        path: the file to write; only an MCAP file may be replaced.
        metadata: the run's metadata.
        final_metadata: returns more metadata when the file ends.
        models: a file of shared models; its models aren't attached again.
        durable: wait for the disk after each chunk.

    Raises:
        RecordingError: the file can't be written.
    """

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, str],
        final_metadata: Callable[[], Mapping[str, str]] = dict,
        *,
        models: SharedModels | None = None,
        durable: bool = False,
    ) -> None:
        self.path = path
        self._final_metadata = final_metadata
        self._models = models
        self._durable = durable
        self._lock = threading.Lock()
        self._buffer: list[_Buffered] = []  # messages since the last chunk was closed
        self._lines = Lines()  # makes the log lines of the records
        self._size = 0  # bytes in the buffer
        self._pending = 0  # records in the buffer
        self._count = 0
        self._now = 0
        self._failed: tuple[str, str] | None = None  # the cause, and a hint
        self._closed = False
        self._schemas: dict[str, int] = {}
        self._channels: dict[_Key, int] = {}
        self._lifetimes: dict[str, int] = {}  # number of worlds so far, by name
        self._frames = FrameTree()
        self._wake = threading.Event()
        self._ended = threading.Event()
        # a daemon thread, so that a program can exit without closing its recording
        self._timer = own(threading.Thread(target=self._flush_periodically, name=f"flush {path.name}", daemon=True))
        start = io.BytesIO()  # prepared in memory: a process that is killed meanwhile leaves no empty file
        self._begin(start, metadata)
        raw = open_output(path)
        self._file = io.BufferedWriter(raw, 1 << 16)
        self._watched = WatchedFile(path, raw)
        with contextlib.ExitStack() as undoing, self._guarded():
            undoing.callback(self._close_file)
            self._writer.move(self._file, start.getvalue())
            if durable:
                self._watched.sync()
                self._watched.sync_name()
            undoing.pop_all()
        self._timer.start()

    def _begin(self, file: io.BytesIO, metadata: Mapping[str, str]) -> None:
        with self._guarded():
            software = versions()
            self._writer = McapWriter(file, f"pycram {software['pycram']}")
            messages: dict[str, type[Message]] = {topic: kind for kind, topic in TOPICS.items()}
            messages |= {"/tf": FrameTransforms, "/log": Log}
            for topic, message in messages.items():
                name, definition = message.DESCRIPTOR.full_name, _descriptors(message)
                self._schemas[topic] = self._writer.add_schema(name, "protobuf", definition)
                if topic not in _PER_WORLD:
                    self._register(topic)
            facts = software | {"format": str(format_number())} | dict(metadata)
            self._writer.add_metadata("pycram", {name: escaped(text) for name, text in facts.items()})
            if self._models is not None:
                self._writer.add_metadata(MODELS_METADATA, {"file": self._models.file, "sha256": self._models.sha256})
            self._writer.flush()

    def _register(self, topic: str, world: str = "", lifetime: int = 0) -> int:
        """Add a channel. If it names a world, the file's index lists the chunks of that world."""
        metadata = {"world": world, "life": str(lifetime)} if lifetime else {}
        channel = self._writer.add_channel(topic, "protobuf", self._schemas[topic], metadata)
        self._channels[topic, world, lifetime] = channel
        return channel

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Buffer a record; see :class:`recorder.tracing.journal.Sink`."""
        seq, now = record.seq, record.wall_time_ns
        with self._lock:
            self._check()
            self._now = now
            self._size += len(payload)
            if topic in _PER_WORLD:
                self._buffer.append(((topic, record.world, self._lifetime(record)), seq, now, payload, None))
                self._add_foxglove(record)
                at_once = False
            else:
                # queries are on their world's channel, because some are looks, from which readers fold beliefs
                of_world = isinstance(record, Query) and record.world in self._lifetimes
                key = (topic, record.world, self._lifetime(record)) if of_world else (topic, "", 0)
                self._buffer.append((key, seq, now, payload, record))
                # readers can't open a file without the start of the run
                at_once = record.status in _FAILURES if isinstance(record, Task) else isinstance(record, Run)
            self._count += 1
            self._pending += 1
            if at_once or self._pending >= _MAX_RECORDS or self._size > _MAX_BYTES:
                with self._guarded():
                    self._flush()
            elif self._pending == 1:
                self._wake.set()

    def _lifetime(self, record: Record) -> int:
        """Return the lifetime of the record's world: 1 for the first world of its name, 2 for the next, ..."""
        lifetime = self._lifetimes.get(record.world, 0)
        if not lifetime or (isinstance(record, Mutation) and record.HasField("open_world")):
            lifetime = self._lifetimes[record.world] = lifetime + 1
        return lifetime

    def _add_foxglove(self, record: Record) -> None:
        for message in self._frames.transforms(record):
            payload = message.SerializeToString()
            self._buffer.append((_TRANSFORMS, record.seq, self._now, payload, None))
            self._size += len(payload)
        line = self._lines.of(record, self._now)
        if line is not None:
            self._buffer.append((_LINES, record.seq, self._now, line, None))

    def _flush(self) -> None:
        """Write the buffer as one chunk and hand it to the operating system; single records would take longer."""
        self._watched.check(self._writer.size)
        buffered, self._buffer = self._buffer, []
        self._pending = self._size = 0
        messages, lines, log = [], self._lines, self._channels[_LINES]
        for key, seq, time_ns, payload, record in buffered:
            messages.append((self._channels.get(key) or self._channel(key), seq, time_ns, payload))
            if record is not None and (line := lines.of(record, time_ns)) is not None:
                messages.append((log, seq, time_ns, line))  # the line follows its record
        self._writer.add_messages(messages)
        self._lines = Lines()
        self._writer.flush()
        if self._durable:
            self._watched.sync()

    def flush(self) -> None:
        """Write the buffered records; see :class:`recorder.tracing.journal.Sink`."""
        with self._lock:
            if self._pending and not self._closed:
                with self._guarded():
                    self._flush()

    def _channel(self, key: _Key) -> int:
        channel = self._channels.get(key)
        if channel is None and len(self._channels) >= _MAX_CHANNELS:
            key = (key[0], "", 0)  # all further worlds share a channel
            channel = self._channels.get(key)
        return self._register(*key) if channel is None else channel

    def attach(self, asset: AssetFile) -> None:
        """Attach a file; see :class:`recorder.tracing.journal.Sink`."""
        with self._lock, self._guarded():
            if self._models is None or asset.key not in self._models.keys:
                self._flush()
                self._writer.add_attachment(self._now, asset.key, asset.media_type, asset.content)
                self._writer.flush()
            if asset.name.endswith(".urdf"):
                self._frames.add_urdf(asset.sha256, asset.content)

    def close(self) -> None:
        """Complete the file; see :class:`recorder.tracing.journal.Sink`."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._ended.set()
            self._wake.set()
        self._timer.join()
        with self._lock:
            try:
                with self._guarded():
                    self._flush()
                    self._writer.add_metadata("pycram.end", {"records": str(self._count), **self._final_metadata()})
                    self._writer.finish()
                    if self._durable:
                        self._watched.sync()
                    self._watched.check(self._writer.size)
            finally:
                self._close_file()

    def _close_file(self) -> None:
        """Close the file; after an error such as a full disk, drop the buffered bytes instead of writing them again."""
        raw = self._file.raw
        with contextlib.suppress(OSError, ValueError):
            self._file.close()
        raw.close()

    @property
    def lock(self) -> threading.Lock:
        """The lock that is held during every change; :mod:`recorder.tracing.forking` holds it during a fork."""
        return self._lock

    @property
    def lost(self) -> str:
        """Why records could not be written; "" if all were written."""
        return "" if self._failed is None else self._failed[0]

    def abandon(self) -> None:
        """Stop writing, in a forked child: the file belongs to its parent."""
        self._closed = True
        self._failed = "this recording belongs to the parent process", ""

    def _flush_periodically(self) -> None:
        """Flush records within the period; runs in the timer's thread."""
        while not self._closed:
            self._wake.wait()
            self._wake.clear()
            if self._ended.wait(_FLUSH_PERIOD):
                return
            with unrecorded(), self._lock:  # if a finalizer prints in this thread, its record would wait for this lock
                if self._pending and self._failed is None and not self._closed:
                    with contextlib.suppress(RecordingError), self._guarded():  # the next write and close() raise it
                        self._flush()

    def _check(self) -> None:
        if self._failed is not None:
            raise RecordingError(self.path, *self._failed)

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """Raise an error of the file as a RecordingError; raise it again at each later use."""
        self._check()
        try:
            yield
        except (OSError, ValueError) as error:
            if isinstance(error, OSError):
                self._failed = reason(error), CHANGED_HINT if isinstance(error, Changed) else HINT
            else:
                self._failed = str(error), ""
            raise RecordingError(self.path, *self._failed) from error


def _descriptors(message: type[Message]) -> bytes:
    """Return a message's definition and the definitions that it uses, without others; imported files come first."""
    needed = [message.DESCRIPTOR]
    for descriptor in needed:  # the loop appends to it
        parts = (field.message_type for field in descriptor.fields)
        needed += [part for part in parts if part is not None and part not in needed]
    names = {descriptor.full_name for descriptor in needed}
    descriptors = FileDescriptorSet()
    added: set[str] = set()

    def add(file: Any) -> None:  # protobuf's two runtimes have two types for it
        if file.name not in added:
            added.add(file.name)
            for dependency in file.dependencies:
                add(dependency)
            definition = descriptors.file.add()
            file.CopyToProto(definition)
            messages = [each for each in definition.message_type if f"{file.package}.{each.name}" in names]
            del definition.message_type[:]
            definition.message_type.extend(messages)

    add(message.DESCRIPTOR.file)
    return descriptors.SerializeToString()


HINT: Final = "free space or choose another path, and run again"
CHANGED_HINT: Final = "don't change it while a plan is recorded, and run again"
_WITHOUT_LOCKS: Final = (errno.ENOTSUP, errno.EINVAL, errno.ENOLCK)  # errors of file systems without locks


def free_path(path: Path) -> Path:
    """Return the path if it has no recording; else return RUN.2.mcap or a later number, and print that on stderr.

    A path with another file is returned unchanged. It may be a device or an empty file; opening rejects other files.
    """
    try:
        if not path.is_file():  # opening a pipe would block
            return path
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                return path
    except OSError:  # reported when the file is opened
        return path
    pattern = re.compile(rf"{re.escape(path.stem)}\.(\d+){re.escape(path.suffix)}")
    numbers = [int(match[1]) for each in path.parent.iterdir() if (match := pattern.fullmatch(each.name))]
    free = path.with_name(f"{path.stem}.{max(numbers, default=1) + 1}{path.suffix}")
    print(f"recorder: {path} exists already; recording to {free}", file=sys.stderr, flush=True)
    return free


def open_output(path: Path) -> io.FileIO:
    """Open and lock a file for writing: a new file, an older recording, which is emptied, or a pipe with a reader.

    Raises:
        RecordingError: the file can't be written, another recording is writing it, or it isn't a recording.
    """
    try:
        file = _open(path)
    except OSError as error:
        if error.errno == errno.ENXIO:
            raise RecordingError(path, "it is a pipe without a reader", "start its reader first") from error
        hint = "make the folder first" if not path.parent.exists() else "choose a path that you may write to"
        raise RecordingError(path, reason(error), hint) from error
    with contextlib.ExitStack() as undoing:
        undoing.callback(file.close)
        try:
            system.lock(file.fileno())
        except BlockingIOError as error:
            raise RecordingError(path, "another recording is writing it", "choose another path") from error
        except OSError as error:
            if error.errno not in _WITHOUT_LOCKS:
                raise RecordingError(path, reason(error), HINT) from error
        if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            start = file.read(len(MAGIC)) or b""
            if start and start != MAGIC:
                raise RecordingError(
                    path, "there is a file that isn't a recording", "move it away or choose another path"
                )
            file.seek(0)
            file.truncate()
        undoing.pop_all()
    return file


def _open(path: Path) -> io.FileIO:
    try:
        is_pipe = stat.S_ISFIFO(path.stat().st_mode)
    except OSError:
        is_pipe = False
    if not is_pipe:
        return io.FileIO(os.open(path, os.O_RDWR | os.O_CREAT | system.OPENED, 0o666), "r+")
    pipe = os.open(path, os.O_WRONLY | os.O_NONBLOCK | system.OPENED)  # a blocking open would wait for a reader
    os.set_blocking(pipe, True)
    return io.FileIO(pipe, "w")


class Changed(OSError):
    """Another program has deleted, replaced or changed a file while it was written."""


class WatchedFile:
    """A file that only this process may change; pipes and devices have no content to check."""

    def __init__(self, path: Path, file: io.FileIO) -> None:
        self._path = path.absolute()  # a plan may change the working directory
        self._number = file.fileno()
        self.is_regular = stat.S_ISREG(os.fstat(self._number).st_mode)

    def check(self, size: int) -> None:
        """Raise :class:`Changed` if the file was moved or replaced, or its size isn't the number of written bytes."""
        if not self.is_regular:
            return
        ours = os.fstat(self._number)
        try:
            there = self._path.stat()
        except OSError as error:
            done = "moved the file away" if ours.st_nlink else "deleted the file"
            raise Changed(f"another program has {done} ({reason(error)})") from error
        if (there.st_dev, there.st_ino) != (ours.st_dev, ours.st_ino):
            raise Changed("another program has replaced the file")
        if ours.st_size != size:
            done = "truncated the file" if ours.st_size < size else "written to the file"
            raise Changed(f"another program has {done}: it has {ours.st_size} bytes instead of {size}")

    def sync(self) -> None:
        """Wait until all written bytes are on the disk."""
        if self.is_regular:
            getattr(os, "fdatasync", os.fsync)(self._number)

    def sync_name(self) -> None:
        """Wait until the folder is on the disk, so that it lists the new file after a power loss."""
        if self.is_regular and hasattr(os, "O_DIRECTORY"):  # Windows doesn't open folders
            folder = os.open(self._path.parent, os.O_RDONLY | system.OPENED)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


def reason(error: OSError) -> str:
    """Return the operating system's message."""
    return error.strerror or str(error)
