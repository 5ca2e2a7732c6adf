"""Decodes the payloads of messages into records; one with more parts than any recorder writes is refused.

An empty part has two bytes in a file, and some fifty times as many in memory. What is so small that it can't have too
many parts isn't counted, which is nearly all.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Final

from google.protobuf.message import DecodeError

if TYPE_CHECKING:
    from recorder.records import Record

MAX_PARTS: Final = 1 << 19
"""Messages within a record; eight texts count as one."""
UNCOUNTED: Final = 2 * MAX_PARTS
"""Bytes of a payload up to which it can't have more parts."""

_TEXTS: Final = 8  # that take as much memory as an empty message
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5  # protobuf's wire types


def decode(kind: type[Record], payload: bytes) -> Record:
    """Return the record of a payload.

    Raises:
        DecodeError: it is none, or has too many parts.
    """
    if len(payload) > UNCOUNTED:
        try:
            _weigh(kind.DESCRIPTOR, payload, 0, len(payload))
        except IndexError:
            raise DecodeError("it is cut off") from None
    return kind.FromString(payload)


@cache
def _within(descriptor: Any) -> dict[int, Any]:  # protobuf's two runtimes have two types for it
    """Return the messages that fields of a message hold, by the fields' numbers."""
    return {field.number: field.message_type for field in descriptor.fields if field.message_type is not None}


def _weigh(descriptor: Any, data: bytes, at: int, end: int) -> int:
    """Return what a message's parts weigh: a text 1, a message 8.

    Raises:
        DecodeError: it is more than that of the most parts, or the message is none.
        IndexError: it is cut off.
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
            raise DecodeError(f"a field is of wire type {wire}")
    return weight


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return the number at an offset, and the offset behind it."""
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
