"""The MCAP format: framing, positions of chunks, decompression, and decoding of payloads."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from functools import cache
from typing import Any, Final, NamedTuple

from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from recorder.records import Record

MAGIC: Final = b"\x89MCAP0\r\n"  # the first and the last bytes of a file
HEADER: Final = 9  # bytes of opcode and length before each MCAP record
LENGTH: Final = struct.Struct("<BQ")  # the fields opcode and length
DATA_END: Final = HEADER + 4  # size in bytes of the record that ends the data
FOOTER: Final = HEADER + 20  # size in bytes of a file's last record
CHANNEL_OFFSET: Final = struct.Struct("<HQ")
CHUNK_INDEX: Final = struct.Struct("<QQQQI")  # start, end, offset, length, size of the next map
#: Further fields: size of the message indexes, and length of the compression's name, in bytes.
_INDEX_LENGTH: Final = struct.Struct("<QI")
_CHUNK: Final = int(Opcode.CHUNK)
_MESSAGE_INDEX: Final = HEADER + 6  # size of a channel's message index before the entries, bytes
_ENTRY: Final = 16  # size of the entry of a message, bytes
CHUNK_HEAD: Final = struct.Struct("<QQQII")  # fields: start, end, size, CRC, and length of the compression's name
MAX_INFLATED: Final = 64 << 20  # larger chunks (bytes) are rejected, because recorders close chunks at about 1 MiB
#: Errors that libraries raise when they decode a damaged file.
DAMAGE: Final = (McapError, struct.error, ValueError, EOFError, OSError, LookupError, ArithmeticError, MemoryError)
#: Errors that reading a damaged chunk raises; Zstandard raises ZstdError, and LZ4 raises RuntimeError.
CHUNK_DAMAGE: Final = (*DAMAGE, ZstdError, RuntimeError)


class Extent(NamedTuple):
    """The position of an MCAP record's content: its length, and its offset in the file."""

    offset: int
    length: int

    @property
    def stop(self) -> int:
        """The offset of the byte after the content."""
        return self.offset + self.length


class StatedHead(NamedTuple):
    """A chunk as the index at the end of a file describes it."""

    head: bytes  # the bytes before the CRC, from the opcode on
    tail: bytes  # the bytes between the CRC and the data
    messages: int | None


class ChunkExtent(NamedTuple):
    """The position of a chunk's content, and the channels of its messages.

    ``channels`` contains 10 bytes for each channel, as MCAP's chunk index does; None if the channels aren't known.
    """

    offset: int
    length: int
    channels: bytes | None = None
    stated: StatedHead | None = None  # None if there is no index

    def ids(self) -> Iterator[int]:
        """Return the ids of the channels; nothing if the channels aren't known."""
        channels = self.channels or b""
        whole = channels[: len(channels) - len(channels) % CHANNEL_OFFSET.size]
        return (channel for channel, _ in CHANNEL_OFFSET.iter_unpack(whole))


def indexed_chunk(summary: bytes, at: int) -> ChunkExtent:
    """Return the chunk that an entry of a summary describes; raise struct.error if the entry is cut off."""
    _, _, offset, length, size = CHUNK_INDEX.unpack_from(summary, at)
    first = at + CHUNK_INDEX.size
    sizes = first + size
    indexes, name = _INDEX_LENGTH.unpack_from(summary, sizes)
    end = sizes + _INDEX_LENGTH.size + name + 8  # the next field is the uncompressed size
    head = LENGTH.pack(_CHUNK, length - HEADER) + summary[at : at + 16] + summary[end : end + 8]
    entries = indexes - _MESSAGE_INDEX * (size // CHANNEL_OFFSET.size)
    stated = StatedHead(head, summary[sizes + 8 : end], entries // _ENTRY if indexes else None)
    return ChunkExtent(offset + HEADER, length - HEADER, summary[first:sizes] or None, stated)


def framed(contents: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the opcode, start and end of each MCAP record's content; raise struct.error if the last head is cut off."""
    at = 0
    while at < len(contents):
        opcode, length = LENGTH.unpack_from(contents, at)
        at += HEADER
        yield opcode, at, at + length
        at += length


def describe(error: Exception) -> str:
    """Return the message of an error; if it has no message, the name of its type."""
    return str(error) or type(error).__name__


def decompressed(chunk: memoryview, zstd: ZstdDecompressor) -> bytes:
    """Return the messages of a chunk; raise CHUNK_DAMAGE if it is damaged.

    A chunk never takes more memory than its header states, and the stated size is limited. Otherwise, a chunk of a few
    kB could inflate to GB.
    """
    _, _, size, crc, length = CHUNK_HEAD.unpack_from(chunk)
    if size > MAX_INFLATED:
        raise ValueError(f"its header states {size} bytes; the maximum is {MAX_INFLATED}")
    start = CHUNK_HEAD.size + length
    end = start + 8 + int.from_bytes(chunk[start : start + 8], "little")
    data = _inflated(bytes(chunk[CHUNK_HEAD.size : start]), chunk[start + 8 : end], size, zstd)
    if len(data) != size:
        raise ValueError(f"it has {len(data)} bytes, but its header states {size}")
    if crc and zlib.crc32(data) != crc:
        raise ValueError("its checksum differs")
    return data


def _inflated(compression: bytes, data: memoryview, size: int, zstd: ZstdDecompressor) -> bytes:
    if compression == b"zstd":
        if frame_content_size(data) > size:
            raise ValueError(f"it inflates to {frame_content_size(data)} bytes, but its header states {size}")
        return zstd.decompress(data, max_output_size=size)
    if compression == b"lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]  # noqa: PLC0415  seldom needed

        inflated: bytes = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        return inflated
    if not compression:
        return bytes(data)
    raise ValueError(f"its compression {compression[:16]!r} is unknown")


#: Maximum number of messages within a record; eight texts count as a message. An empty message takes two bytes in a
#: file, and a hundred bytes in memory.
MAX_PARTS: Final = 1 << 19
UNCOUNTED: Final = 2 * MAX_PARTS  # payloads of at most this size in bytes can't have too many parts
_TEXTS: Final = 8  # this many texts take as much memory as an empty message
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5  # protobuf's wire types


def decode(kind: type[Record], payload: bytes) -> Record:
    """Return the record of a payload; raise DecodeError if the payload is invalid, or has too many parts."""
    if len(payload) > UNCOUNTED:
        try:
            _weigh(kind.DESCRIPTOR, payload, 0, len(payload))
        except IndexError:
            raise DecodeError("it is cut off") from None
    return kind.FromString(payload)


@cache
def _within(descriptor: Any) -> dict[int, Any]:  # both runtimes of protobuf have their own type of descriptors
    """Return the types of a message's fields by field number, without fields that aren't messages themselves."""
    return {field.number: field.message_type for field in descriptor.fields if field.message_type is not None}


def _weigh(descriptor: Any, data: bytes, at: int, end: int) -> int:
    """Return the weight of a message's parts: 1 for each text, 8 for each message.

    Raises:
        DecodeError: There are too many parts, or the message is invalid.
        IndexError: The message is incomplete.
    """
    within, weight = _within(descriptor), 0
    while at < end:
        tag, at = _varint(data, at)
        wire = tag & 7
        if wire == _BYTES:
            length, at = _varint(data, at)
            part = within.get(tag >> 3)
            if at + length > end:
                raise IndexError
            weight += 1 if part is None else _TEXTS + _weigh(part, data, at, at + length)
            if weight > MAX_PARTS * _TEXTS:
                raise DecodeError(f"it has more than {MAX_PARTS} parts")
            at += length
        elif wire == _VARINT:
            _, at = _varint(data, at)
        elif wire in (_FIXED64, _FIXED32):
            at += 8 if wire == _FIXED64 else 4
        else:
            raise DecodeError(f"a field has the unknown wire type {wire}")
    return weight


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return the number at an offset, and the offset of the byte after it."""
    value = data[at]
    at += 1
    if value < 1 << 7:
        return value, at
    value &= 0x7F
    for shift in range(7, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 1 << 7:
            return value, at
    raise DecodeError("a number is too long")
