"""Write a sound copy of the readable part of a recording, with an index and all checksums.

Messages, attached files and metadata are copied unchanged, so fields of newer releases are kept. Steps keep their
numbers. The metadata of the copy lists the missing steps.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import BinaryIO, Final

from google.protobuf.message import DecodeError
from mcap.opcode import Opcode

from recorder.mcap_writer import MODELS_METADATA, McapWriter
from recorder.records import Record
from replay.errors import Damaged
from replay.file.assets import Assets
from replay.file.chunks import Chunks, kinds_of
from replay.file.index import Index
from replay.file.mcap_format import CHUNK_DAMAGE, decode, describe, framed

_METADATA: Final = "pycram.repair"
_MESSAGE: Final = struct.Struct("<HIQQ")  # fields of a message: channel, sequence, log time, publish time
_MOST_MESSAGES: Final = 10_000  # maximum number of messages in a chunk of the copy
_RANGES: Final = re.compile(r"\d{1,18}(-\d{1,18})?(, \d{1,18}(-\d{1,18})?)*")
_MAX_TEXT: Final = 1 << 16  # maximum number of characters of the list of lost steps


@dataclass(frozen=True, slots=True)
class Losses:
    """The losses of a repaired copy."""

    problems: str  # problems of the original, as text
    steps: tuple[range, ...]  # known ranges of lost steps
    records: int  # number of kept records
    chunks: Mapping[int, str]  # why chunks are lost, by their number in the original
    messages: int  # number of unreadable messages in other chunks
    files: Mapping[str, str]  # why attached files are lost, by name


def write_sound(
    file: BinaryIO, index: Index, chunks: Chunks, assets: Assets, problems: str | None, missing: list[range]
) -> Losses:
    """Write a sound copy of the readable part into an empty file, with shared models.

    The copy lists the problems and missing steps of the original, unless ``problems`` is None.
    """
    from recorder.packages import versions  # noqa: PLC0415

    release = versions()["pycram"]
    writer = McapWriter(file, f"pycram {release}")
    ids = _define(writer, index)
    repair = {"problems": problems or "", "by": release, "lost": ", ".join(map(range_text, missing))}
    metadata = index.metadata | ({} if problems is None else {_METADATA: repair})
    if not assets.missing(look=True):
        metadata.pop(MODELS_METADATA, None)
    for name, values in metadata.items():
        writer.add_metadata(name, values)
    for name in assets:
        try:
            kept = assets.attachment(name)
        except Damaged:  # assets.damaged contains the damage
            continue
        writer.add_attachment(kept.log_time, name, kept.media_type, kept.data)
    kinds = kinds_of(index)
    lost: dict[int, str] = {}
    records = unread = 0
    for number in range(len(chunks)):
        try:
            messages = _messages(chunks.contents(number)[0])
        except CHUNK_DAMAGE as error:
            lost[number] = describe(error)
            continue
        try:
            while found := list(islice(messages, _MOST_MESSAGES)):
                kept_messages = [message for message in found if message[0] in ids and _is_sound(message, kinds)]
                unread += len(found) - len(kept_messages)
                records += sum(channel in kinds for channel, *_ in kept_messages)
                kept_messages.sort(key=lambda message: message[2])  # a stable sort by time
                writer.add_messages([(ids[channel], number, at, data) for channel, number, at, data in kept_messages])
                writer.flush()
        except struct.error as error:
            lost[number] = describe(error)
    writer.finish()
    return Losses(problems or "", tuple(missing), records, lost, unread, dict(assets.damaged))


def _define(writer: McapWriter, index: Index) -> dict[int, int]:
    """Define the channels whose message types are known; return their new ids by their old ids."""
    schemas: dict[str, int] = {}
    ids = {}
    for number, channel in index.channels.items():
        name = index.schemas.get(channel.schema_id)
        if name is None:
            continue
        if name not in schemas:
            schemas[name] = writer.add_schema(name, "protobuf", index.definitions[name])
        ids[number] = writer.add_channel(channel.topic, channel.message_encoding, schemas[name], channel.metadata)
    writer.flush()
    return ids


def _messages(contents: bytes) -> Iterator[tuple[int, int, int, bytes]]:
    """Yield the channel, sequence, log time and payload of each message in a chunk."""
    for opcode, start, stop in framed(contents):
        if opcode == Opcode.MESSAGE:
            channel, sequence, time_ns, _ = _MESSAGE.unpack_from(contents, start)
            yield channel, sequence, time_ns, contents[start + _MESSAGE.size : stop]


def _is_sound(message: tuple[int, int, int, bytes], kinds: Mapping[int, type[Record]]) -> bool:
    """Return whether a message can be decoded, or belongs to another program."""
    channel, _, _, payload = message
    try:
        _ = decode(kinds[channel], payload) if channel in kinds else None
    except DecodeError:
        return False
    return True


def lost_before(index: Index) -> tuple[range, ...]:
    """Return the ranges of steps that a recording had lost before it was repaired."""
    text = index.metadata.get(_METADATA, {}).get("lost", "")[:_MAX_TEXT]
    if not text.isascii() or not _RANGES.fullmatch(text):
        return ()
    bounds = [[int(number) for number in part.split("-")] for part in text.split(", ")]
    return tuple(range(each[0], each[-1] + 1) for each in bounds)


def range_text(steps: range) -> str:
    """Return a text for steps, such as "3-7"."""
    return str(steps.start) if len(steps) == 1 else f"{steps.start}-{steps.stop - 1}"
