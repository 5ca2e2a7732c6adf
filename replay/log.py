"""Opens recordings: records by their step, also from files whose process was killed.

A finished file has an index of its chunks; one that was cut is scanned once for whole chunks. Either way a chunk is
decompressed when a step in it is asked for, and its first step is found by bisection: steps increase along the file.
"""

from __future__ import annotations

import io
import struct
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk

from recorder.records import TOPICS, Event, Keyframe, Mutation, Query, Run, Task
from replay.errors import NoSuchStep, NotALog

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from types import TracebackType

    from typing_extensions import Self

    from recorder.records import Record

MAGIC: Final = b"\x89MCAP0\r\n"
KINDS: Final = {topic.removeprefix("/"): kind for kind, topic in TOPICS.items()}
_CACHED: Final = 16  # chunks
_HEADER: Final = 9  # bytes of opcode and length before each MCAP record
_BROKEN: Final = (McapError, struct.error, ValueError, EOFError, OSError, KeyError, IndexError, MemoryError)

__all__ = ["KINDS", "Event", "Keyframe", "Log", "Mutation", "Query", "Run", "Task", "open_log"]


@dataclass(frozen=True, slots=True)
class _Place:
    """Where something lies in the file: offset of its MCAP record, and its length after the header."""

    offset: int
    length: int


class Log:
    """A recording; use :func:`open_log` or ``replay.open``.

    Attributes:
        path: the file.
        complete: whether the file was closed by its recorder and is whole.
        missing: in words, what is missing otherwise.
        metadata: what the recorder said of the run: versions, platform, arguments.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.complete = False
        self.missing = ""
        self.metadata: dict[str, str] = {}
        self._chunks: list[_Place] = []
        self._attachments: dict[str, _Place] = {}
        self._topics: dict[int, str] = {}
        self._cache: OrderedDict[int, list[Record]] = OrderedDict()
        self._first: dict[int, int] = {}
        self._file = _open(self.path)
        try:
            self._index()
            self._length = self._count()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    # --- reading ---------------------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, step: int) -> Record:
        """The record of a step; negative steps count from the end.

        Raises:
            NoSuchStep: there is none.
        """
        wanted = step + self._length if step < 0 else step
        if not 0 <= wanted < self._length:
            raise NoSuchStep(step, self._length)
        for record in self._records(self._chunk_of(wanted)):
            if record.seq == wanted:
                return record
        raise NoSuchStep(step, self._length, "; that part of the file is damaged")

    def __iter__(self) -> Iterator[Record]:
        return self.records()

    def records(self, kind: type[Record] | None = None, start: int = 0, stop: int | None = None) -> Iterator[Record]:
        """Records in order, read as they are asked for.

        Args:
            kind: only those of one type.
            start: first step.
            stop: the step before which to end; the end by default.
        """
        end = self._length if stop is None else min(stop, self._length)
        if start >= end:
            return
        for index in range(self._chunk_of(start), len(self._chunks)):
            for record in self._records(index):
                if record.seq >= end:
                    return
                if record.seq >= start and (kind is None or isinstance(record, kind)):
                    yield record

    def backwards(self, start: int) -> Iterator[Record]:
        """Records from a step down to the first.

        Args:
            start: the step to begin with.
        """
        for index in range(self._chunk_of(start), -1, -1):
            for record in reversed(self._records(index)):
                if record.seq <= start:
                    yield record

    @property
    def assets(self) -> Mapping[str, _Place]:
        """Names of the attached files; read one with :meth:`asset`."""
        return dict(self._attachments)

    def asset(self, name: str) -> bytes:
        """The content of an attached file.

        Args:
            name: ``<sha256>/<file name>``.

        Raises:
            KeyError: there is none of that name.
        """
        place = self._attachments[name]
        content: bytes = Attachment.read(ReadDataStream(io.BytesIO(self._bytes(place)))).data
        return content

    @cached_property
    def first_steps(self) -> Mapping[str, int]:
        """The first step of each world; reads the recording once."""
        found: dict[str, int] = {}
        for record in self.records():
            if isinstance(record, Keyframe | Mutation):
                found.setdefault(record.world, record.seq)
        return found

    # --- index -----------------------------------------------------------------------------------------------------

    def _index(self) -> None:
        self._file.seek(0)
        try:
            summary = make_reader(self._file).get_summary()
        except _BROKEN:
            summary = None
        if summary is None or not summary.chunk_indexes:
            self._scan()
        else:
            for chunk in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset):
                self._chunks.append(_Place(chunk.chunk_start_offset, chunk.chunk_length - _HEADER))
            for attachment in summary.attachment_indexes:
                self._attachments[attachment.name] = _Place(attachment.offset, attachment.length - _HEADER)
            self._topics = {number: channel.topic for number, channel in summary.channels.items()}
            for index in summary.metadata_indexes:
                self._take_metadata(_Place(index.offset, index.length - _HEADER))
            self.complete = True
        if not set(self._topics.values()) >= {"/run", "/mutation"}:
            raise NotALog(self.path, "is an MCAP file, but no recording of PyCRAM")

    def _take_metadata(self, place: _Place) -> None:
        told = Metadata.read(ReadDataStream(io.BytesIO(self._bytes(place))))
        self.metadata |= {
            f"{told.name}.{key}" if told.name != "pycram" else key: told.metadata[key] for key in told.metadata
        }

    def _scan(self) -> None:
        """Finds the whole parts of a file without index."""
        self.missing = "it was not closed: its process was killed, or still writes it"
        size = self.path.stat().st_size
        offset = len(MAGIC)
        while offset + _HEADER <= size:
            self._file.seek(offset)
            header = self._file.read(_HEADER)
            length = int.from_bytes(header[1:], "little")
            if header[0] == Opcode.DATA_END:
                break
            if offset + _HEADER + length > size:
                self.missing += f"; the last {size - offset} bytes are torn"
                break
            place = _Place(offset, length)
            try:
                self._take(header[0], place)
            except _BROKEN as error:
                self.missing += f"; what stands at byte {offset} is damaged ({error})"
            offset += _HEADER + length

    def _take(self, opcode: int, place: _Place) -> None:
        if opcode == Opcode.CHUNK:
            self._chunks.append(place)
            if not self._topics:
                self._learn(place)
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(io.BytesIO(self._bytes(place))))
            self._topics[channel.id] = channel.topic
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(ReadDataStream(io.BytesIO(self._bytes(place))))
            self._attachments[attachment.name] = place
        elif opcode == Opcode.METADATA:
            self._take_metadata(place)

    def _learn(self, place: _Place) -> None:
        for record in breakup_chunk(Chunk.read(ReadDataStream(io.BytesIO(self._bytes(place))))):
            if isinstance(record, Channel):
                self._topics[record.id] = record.topic

    def _bytes(self, place: _Place) -> bytes:
        self._file.seek(place.offset + _HEADER)
        return self._file.read(place.length)

    def _count(self) -> int:
        while self._chunks:
            records = self._records(len(self._chunks) - 1)
            if records:
                return records[-1].seq + 1
            self._chunks.pop()  # damaged, or of other topics only
        raise NotALog(self.path, "has no record that can be read")

    def _chunk_of(self, step: int) -> int:
        """Index of the chunk that a step is in: the last one that doesn't begin behind it."""
        low, high = 0, len(self._chunks) - 1
        while low < high:
            middle = (low + high + 1) // 2
            if self._first_of(middle) <= step:
                low = middle
            else:
                high = middle - 1
        return low

    def _first_of(self, index: int) -> int:
        if index not in self._first:
            records = self._records(index)
            # a chunk without records of ours counts as the one before it
            self._first[index] = records[0].seq if records else self._first_of(index - 1) if index else 0
        return self._first[index]

    def _records(self, index: int) -> list[Record]:
        if index in self._cache:
            self._cache.move_to_end(index)
            return self._cache[index]
        found: list[Record] = []
        try:
            chunk = Chunk.read(ReadDataStream(io.BytesIO(self._bytes(self._chunks[index]))))
            for record in breakup_chunk(chunk, validate_crc=True):
                if isinstance(record, Channel | Schema):
                    if isinstance(record, Channel):
                        self._topics[record.id] = record.topic
                elif isinstance(record, Message):
                    kind = KINDS.get(self._topics.get(record.channel_id, "").removeprefix("/"))
                    if kind is not None:
                        found.append(kind.FromString(record.data))
        except (*_BROKEN, ArithmeticError, RuntimeError, AssertionError) as error:
            self._damaged(index, error)
        except Exception as error:  # noqa: BLE001  decompressors and protobuf have errors of their own without common base
            self._damaged(index, error)
        self._cache[index] = found
        if len(self._cache) > _CACHED:
            self._cache.popitem(last=False)
        return found

    def _damaged(self, index: int, error: Exception) -> None:
        self.complete = False
        told = f"chunk {index} is damaged ({error})"
        if told not in self.missing:
            self.missing = f"{self.missing}; {told}" if self.missing else told


def _open(path: Path) -> io.BufferedReader:
    try:
        file = path.open("rb")
    except OSError as error:
        raise NotALog(path, error.strerror or str(error)) from error
    start = file.read(len(MAGIC))
    if start != MAGIC:
        file.close()
        raise NotALog(path, "is empty" if not start else "is no MCAP file")
    return file


def open_log(path: str | Path) -> Log:
    """Opens a recording.

    Args:
        path: the MCAP file; finished, cut, or still being written.

    Raises:
        NotALog: it isn't one, or nothing of it can be read.
    """
    return Log(path)
