"""Write records into an MCAP file that survives the death of its process.

A killed process loses only the records of the open chunk. :class:`McapSink` closes a chunk after 50 records, after 50
ms, after failures, and before native code that blocks all threads. A thread measures the 50 ms, so native code that
holds the interpreter lock delays the end of a chunk.
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
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, TypeAlias

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message

from recorder import system
from recorder.errors import RecordingError
from recorder.mcap_writer import MAGIC, MODELS_METADATA, McapWriter, SharedModels
from recorder.packages import versions
from recorder.records import TOPICS, Keyframe, Mutation, Query, Record, Run, Task, escaped, format_number
from recorder.records.motion import FrameTree
from recorder.records.text import log_line
from recorder.records.values import AssetFile
from recorder.tracing.forking import own
from recorder.tracing.journal import unrecorded

_MAX_RECORDS: Final = 50  # maximum number of records in a chunk
_MAX_BYTES: Final = 1 << 20  # maximum number of bytes in a chunk
_FLUSH_PERIOD: Final = 0.05  # s
_Key: TypeAlias = tuple[str, str, int]  # topic, world and its lifetime; "" and 0 for all worlds
#: A buffered message: key of the channel, number and time of the record, bytes, and the record; None instead of a
#: record without a further line in the log.
_Buffered: TypeAlias = "tuple[_Key, int, int, bytes, Record | None]"
_LINES: Final = ("/log", "", 0)
_TRANSFORMS: Final = ("/tf", "", 0)
_FAILURES: Final = frozenset({Task.FAILED, Task.CANCELLED})
_PER_WORLD: Final = frozenset(TOPICS[kind] for kind in (Mutation, Keyframe))  # topics with a channel for each world
_MAX_CHANNELS: Final = 1000  # all further worlds share channels; MCAP allows 65,535


class McapSink:
    """A sink that is one MCAP file.

    Args:
        path: The file to write. An existing file is replaced only if it is an MCAP file.
        final_metadata: A function that returns more metadata when the file ends.
        models: A file of shared models. The recording doesn't contain these models again.
        durable: Wait for the disk after each chunk, so that a power failure loses no closed chunk.

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
        self.lock = threading.Lock()  # :mod:`recorder.tracing.forking` holds the lock during a fork
        self._buffer: list[_Buffered] = []  # messages since the last chunk was closed
        self._size = 0  # number of bytes in the buffer
        self._pending = 0  # number of records in the buffer
        self._count = 0
        self._now = 0
        self._failed: tuple[str, str] | None = None  # cause and hint of the first write error
        self._closed = False
        self._schemas: dict[str, int] = {}
        self._channels: dict[_Key, int] = {}
        self._lifetimes: dict[str, int] = {}  # number of worlds with each name so far
        self._frames = FrameTree()
        self._wake = threading.Event()
        self._ended = threading.Event()
        # a daemon thread, because programs may exit without closing their recording
        self._timer = own(threading.Thread(target=self._flush_periodically, name=f"flush {path.name}", daemon=True))
        start = io.BytesIO()  # prepared in memory: a killed process leaves no empty file
        with self._guarded():
            software = versions()
            self._writer = McapWriter(start, f"pycram {software['pycram']}")
            messages: dict[str, type[Message]] = {topic: kind for kind, topic in TOPICS.items()}
            messages |= {"/tf": FrameTransforms, "/log": Log}
            for topic, message in messages.items():
                name = message.DESCRIPTOR.full_name
                self._schemas[topic] = self._writer.add_schema(name, "protobuf", definition(message))
                if topic not in _PER_WORLD:
                    self._register(topic)
            facts = software | {"format": str(format_number())} | dict(metadata)
            self._writer.add_metadata("pycram", {name: escaped(text) for name, text in facts.items()})
            if self._models is not None:
                self._writer.add_metadata(MODELS_METADATA, {"file": self._models.file, "sha256": self._models.sha256})
            self._writer.flush()
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

    def _register(self, topic: str, world: str = "", lifetime: int = 0) -> int:
        """Add a channel. If a channel names a world, the file's index lists the chunks of that world."""
        metadata = {"world": world, "life": str(lifetime)} if lifetime else {}
        channel = self._writer.add_channel(topic, "protobuf", self._schemas[topic], metadata)
        self._channels[topic, world, lifetime] = channel
        return channel

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Buffer a record."""
        seq, now = record.seq, record.wall_time_ns
        with self.lock:
            self._check()
            self._now = now
            self._size += len(payload)
            if topic in _PER_WORLD:
                self._buffer.append(((topic, record.world, self._lifetime(record)), seq, now, payload, None))
                for message in self._frames.transforms(record):
                    payload = message.SerializeToString()
                    self._buffer.append((_TRANSFORMS, record.seq, self._now, payload, None))
                    self._size += len(payload)
                line = log_line(record, self._now)
                if line is not None:
                    self._buffer.append((_LINES, record.seq, self._now, line, None))
                at_once = False
            else:
                # readers compute beliefs from queries of perception, so these queries are on the channel of their world
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
        """Return the number of worlds with this name so far, including the record's world."""
        lifetime = self._lifetimes.get(record.world, 0)
        if not lifetime or (isinstance(record, Mutation) and record.HasField("open_world")):
            lifetime = self._lifetimes[record.world] = lifetime + 1
        return lifetime

    def _flush(self) -> None:
        self._watched.check(self._writer.size)
        buffered, self._buffer = self._buffer, []
        self._pending = self._size = 0
        messages, log = [], self._channels[_LINES]
        for key, seq, time_ns, payload, record in buffered:
            messages.append((self._channels.get(key) or self._channel(key), seq, time_ns, payload))
            if record is not None and (line := log_line(record, time_ns)) is not None:
                messages.append((log, seq, time_ns, line))  # the line in the log follows its record
        self._writer.add_messages(messages)
        self._writer.flush()
        if self._durable:
            self._watched.sync()

    def flush(self) -> None:
        """Write the buffered records."""
        with self.lock:
            if self._pending and not self._closed:
                with self._guarded():
                    self._flush()

    def _channel(self, key: _Key) -> int:
        if len(self._channels) >= _MAX_CHANNELS:  # further worlds share a channel
            return self._channels.get((key[0], "", 0)) or self._register(key[0])
        return self._register(*key)

    def attach(self, asset: AssetFile) -> None:
        """Attach a file."""
        with self.lock, self._guarded():
            if self._models is None or asset.key not in self._models.keys:
                self._flush()
                self._writer.add_attachment(self._now, asset.key, asset.media_type, asset.content)
                self._writer.flush()
            if asset.name.endswith(".urdf"):
                self._frames.add_urdf(asset.sha256, asset.content)

    def close(self) -> None:
        """Complete the file."""
        with self.lock:
            if self._closed:
                return
            self._closed = True
            self._ended.set()
            self._wake.set()
        self._timer.join()
        with self.lock:
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
    def lost(self) -> str:
        """The cause of the first write error; "" without an error."""
        return "" if self._failed is None else self._failed[0]

    def abandon(self) -> None:
        """Stop writing in a forked child, because the file belongs to the parent process."""
        self._closed = True
        self._failed = "this recording belongs to the parent process", ""

    def _flush_periodically(self) -> None:
        while not self._closed:
            self._wake.wait()
            self._wake.clear()
            if self._ended.wait(_FLUSH_PERIOD):
                return
            with unrecorded(), self.lock:  # a finalizer may print in this thread, and would wait for this lock
                if self._pending and self._failed is None and not self._closed:
                    with contextlib.suppress(RecordingError), self._guarded():  # the next write also raises this error
                        self._flush()

    def _check(self) -> None:
        if self._failed is not None:
            raise RecordingError(self.path, *self._failed)

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """Raise an error of the file as a RecordingError, now and in later calls."""
        self._check()
        try:
            yield
        except (OSError, ValueError) as error:
            if isinstance(error, OSError):
                self._failed = reason(error), CHANGED_HINT if isinstance(error, Changed) else HINT
            else:
                self._failed = str(error), ""
            raise RecordingError(self.path, *self._failed) from error


def definition(message: type[Message]) -> bytes:
    """Return the definition of a message with all definitions that it uses. Imported files come first."""
    needed = [message.DESCRIPTOR]
    for descriptor in needed:  # the loop appends to the list that it iterates over
        parts = (field.message_type for field in descriptor.fields)
        needed += [part for part in parts if part is not None and part not in needed]
    names = {descriptor.full_name for descriptor in needed}
    descriptors = FileDescriptorSet()
    added: set[str] = set()

    def add(file: Any) -> None:  # both runtimes of protobuf have their own type of files
        if file.name not in added:
            added.add(file.name)
            for dependency in file.dependencies:
                add(dependency)
            added_file = descriptors.file.add()
            file.CopyToProto(added_file)
            messages = [each for each in added_file.message_type if f"{file.package}.{each.name}" in names]
            del added_file.message_type[:]
            added_file.message_type.extend(messages)

    add(message.DESCRIPTOR.file)
    return descriptors.SerializeToString()


HINT: Final = "free space or choose another path, and run again"
CHANGED_HINT: Final = "don't change the file while a plan is recorded, and run again"
_WITHOUT_LOCKS: Final = (errno.ENOTSUP, errno.EINVAL, errno.ENOLCK)  # errors of file systems that have no locks


def free_path(path: Path) -> Path:
    """Return the path, or RUN.2.mcap or a later number if the path has a recording. A new path is printed on stderr."""
    try:
        if not path.is_file():  # opening a pipe here would block
            return path
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                return path
    except OSError:  # opening the file later reports the error
        return path
    pattern = re.compile(rf"{re.escape(path.stem)}\.(\d+){re.escape(path.suffix)}")
    numbers = [int(match[1]) for each in path.parent.iterdir() if (match := pattern.fullmatch(each.name))]
    free = path.with_name(f"{path.stem}.{max(numbers, default=1) + 1}{path.suffix}")
    print(f"recorder: {path} exists already; recording to {free}", file=sys.stderr, flush=True)
    return free


def open_output(path: Path) -> io.FileIO:
    """Open and lock a new file, an older recording, which is emptied, or a pipe; raise RecordingError for others."""
    try:
        is_pipe = path.is_fifo()
        # without O_NONBLOCK, opening a pipe waits for a reader
        flags = os.O_WRONLY | os.O_NONBLOCK if is_pipe else os.O_RDWR | os.O_CREAT
        file = io.FileIO(os.open(path, flags | system.OPENED, 0o666), "w" if is_pipe else "r+")
        if is_pipe:
            os.set_blocking(file.fileno(), True)
    except OSError as error:
        if error.errno == errno.ENXIO:
            raise RecordingError(path, "the file is a pipe without a reader", "start its reader first") from error
        hint = "make the folder first" if not path.parent.exists() else "choose a path that you may write to"
        raise RecordingError(path, reason(error), hint) from error
    with contextlib.ExitStack() as undoing:
        undoing.callback(file.close)
        try:
            system.lock(file.fileno())
        except BlockingIOError as error:
            raise RecordingError(path, "another recording is writing this file", "choose another path") from error
        except OSError as error:
            if error.errno not in _WITHOUT_LOCKS:
                raise RecordingError(path, reason(error), HINT) from error
        if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            start = file.read(len(MAGIC)) or b""
            if start and start != MAGIC:
                raise RecordingError(
                    path, "there is a file that isn't a recording", "move the file away or choose another path"
                )
            file.seek(0)
            file.truncate()
        undoing.pop_all()
    return file


class Changed(OSError):
    """Another program has deleted, replaced or changed a file while it was written."""


class WatchedFile:
    """A file that no other process may change while it is written. Pipes and devices aren't checked."""

    def __init__(self, path: Path, file: io.FileIO) -> None:
        self._path = path.absolute()  # absolute, because a plan may change the working directory
        self._number = file.fileno()
        self.is_regular = stat.S_ISREG(os.fstat(self._number).st_mode)

    def check(self, size: int) -> None:
        """Raise :class:`Changed` if another program moved or replaced the file, or if its size isn't ``size`` bytes."""
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
        """Wait until the folder is on the disk, so that the file isn't lost in a power failure."""
        if self.is_regular and hasattr(os, "O_DIRECTORY"):  # Windows doesn't open folders
            folder = os.open(self._path.parent, os.O_RDONLY | system.OPENED)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


def reason(error: OSError) -> str:
    """Return the operating system's message about an error."""
    return error.strerror or str(error)
