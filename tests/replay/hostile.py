"""Recordings that a stranger has written: copies of a sound one in which anything may be something else.

Their checksums are right: what is wrong is what they say. All that is random comes from a seed.
"""

from __future__ import annotations

import random
import struct
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from google.protobuf.descriptor import FieldDescriptor
from mcap.opcode import Opcode

import replay
from recorder.mcap_writer import McapWriter
from recorder.records import TOPICS, Asset
from recorder.records.values import AssetFile
from tests.replay.copies import container_records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from google.protobuf.message import Message
    from mcap.data_stream import RecordBuilder
    from mcap.records import McapRecord

    from recorder.records import Record

_INTEGERS: Final = (-1, 0, 3, 2**31 - 1, -(2**31))
_LONG: Final = (*_INTEGERS, 2**63 - 1, -(2**63), 3_000_000_000_000_000_000)
_NUMBERS: Final = (float("nan"), float("inf"), -float("inf"), 1e30, 1e300, 1e-300, -1.5, 0.0)
_TEXTS: Final = (
    "",
    "zzz",
    "../../../etc/passwd",
    "/dev/zero",
    "{",
    "[" * 100_000,
    "9" * 4000,
    "[1e999, NaN]",
    '{"object": 3, "world": [], "pairs": 7}',
    "\x1b[2J\u202e\x00",
    "x" * 100_000,
)
WRONG: Final[Mapping[int, tuple[Any, ...]]] = {
    FieldDescriptor.CPPTYPE_DOUBLE: _NUMBERS,
    FieldDescriptor.CPPTYPE_STRING: _TEXTS,
    FieldDescriptor.CPPTYPE_INT64: _LONG,
    FieldDescriptor.CPPTYPE_INT32: _INTEGERS,
    FieldDescriptor.CPPTYPE_BOOL: (True, False),
    FieldDescriptor.CPPTYPE_ENUM: (0, 1, 2, 3, 4, 5, 99, -1),
}


def rewritten(
    sound: Path,
    target: Path,
    change: Callable[[list[Record], dict[str, bytes]], None] | None = None,
    metadata: Mapping[str, str] | None = None,
    channels: Mapping[str, str] | None = None,
) -> Path:
    """Write a copy of a recording after a change of its records and its attached files by name.

    Args:
        sound: the recording.
        target: the copy.
        change: changes records and files.
        metadata: of the run, to be added.
        channels: metadata of channels, to be added.
    """
    with replay.open(sound) as log:
        records, assets, values = list(log), dict(log.assets), dict(log.metadata) | dict(metadata or {})
        made = [(channel.topic, dict(channel.metadata)) for channel in log._index.channels.values()]
    if change is not None:
        change(records, assets)
    with target.open("wb") as file:
        writer = McapWriter(file, "pycram")
        ids: dict[tuple[type[Record], str], int] = {}
        for kind, topic in TOPICS.items():
            schema = writer.add_schema(kind.DESCRIPTOR.full_name, "protobuf", b"")
            for of in [{}, *(values for name, values in made if name == topic and values)]:
                named = of | dict(channels or {})
                ids[kind, of.get("world", "")] = writer.add_channel(topic, "protobuf", schema, named)
        writer.add_metadata("pycram", values)
        for name, content in assets.items():
            writer.add_attachment(0, name, "", content)
        for at, record in enumerate(records):
            channel = ids.get((type(record), record.world)) or ids[type(record), ""]
            writer.add_messages([(channel, at, at, record.SerializeToString())])
            if at % 50 == 49:
                writer.flush()
        writer.finish()
    return target


@contextmanager
def lying(kind: type[McapRecord], lie: Callable[[Any], None]) -> Iterator[None]:
    """Change what recordings that are written meanwhile have of a kind in their index."""
    write = kind.write

    def written(index: McapRecord, stream: RecordBuilder) -> None:
        lie(index)
        write(index, stream)

    kind.write = written  # type: ignore[method-assign]
    try:
        yield
    finally:
        kind.write = write  # type: ignore[method-assign]


def replace_file(records: list[Record], assets: dict[str, bytes], name: str, content: bytes, file: str = "") -> None:
    """Put another file in the place of an attached one, whatever names it: with the name that its content has."""
    old, _, kept = name.partition("/")
    new = AssetFile(file or kept, content)
    del assets[name]
    assets[new.key] = content
    for record in records:
        for asset in (part for part in parts(record) if isinstance(part, Asset)):
            if asset.sha256 == old:
                asset.sha256, asset.path = new.sha256, new.name
    for model in [key for key, text in assets.items() if key.endswith(".urdf") and name.encode() in text]:
        replace_file(records, assets, model, assets[model].replace(name.encode(), new.key.encode()))


def parts(message: Message) -> Iterator[Message]:
    """A message and all messages in it."""
    yield message
    for field, value in message.ListFields():
        if field.message_type:
            for part in value if hasattr(value, "append") else [value]:
                yield from parts(part)


def spoil(message: Message, dice: random.Random) -> None:
    """Make one field of a message wrong: another value, nothing, or many."""
    part = dice.choice(list(parts(message)))
    field = dice.choice(list(part.DESCRIPTOR.fields))
    value, way = getattr(part, field.name), dice.random()
    repeated = hasattr(value, "append") or hasattr(value, "add")
    if field.message_type:
        if way < 0.4 or not repeated:
            part.ClearField(field.name)
            if way < 0.2 and not repeated:
                value.SetInParent()
        else:
            value.add()
            value.extend([dice.choice(value)] * dice.choice((0, 1, 300)))
    elif not repeated:
        setattr(part, field.name, dice.choice(WRONG[field.cpp_type]))
    elif way < 0.3 and value:
        del value[dice.randrange(len(value))]
    elif way < 0.5 or not value:
        value.extend([dice.choice(WRONG[field.cpp_type])] * dice.choice((1, 3, 3000)))
    else:
        value[dice.randrange(len(value))] = dice.choice(WRONG[field.cpp_type])


def flip(content: bytes, dice: random.Random) -> bytes:
    """Change some bytes of a file: one, a run of them, or all from there on."""
    at, way = dice.randrange(8, len(content)), dice.random()
    if way < 0.5:
        return content[:at] + bytes([content[at] ^ 1 << dice.randrange(8)]) + content[at + 1 :]
    if way < 0.7:
        length = dice.randrange(1, 400)
        return content[:at] + dice.randbytes(length) + content[at + length :]
    if way < 0.8:
        return content[:at]
    number = dice.choice((0, 1, 2**16, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1))
    starts = [start for _, start, _ in container_records(content, Opcode.FOOTER)]
    at = dice.choice(starts) + 1 if way < 0.95 and starts else at
    return content[:at] + struct.pack("<Q", number) + content[at + 8 :]


def mutated(sound: Path, target: Path, seed: int) -> Path:
    """Write a copy of a recording in which some fields of its records, or some bytes, are wrong."""
    dice = random.Random(seed)
    if dice.random() < 0.35:
        target.write_bytes(flip(sound.read_bytes(), dice))
        return target

    def change(records: list[Record], assets: dict[str, bytes]) -> None:
        if dice.random() < 0.15:
            name = dice.choice([name for name in assets if not name.endswith(".py")])
            replace_file(records, assets, name, flip(b"12345678" + assets[name], dice)[8:])
            return
        for _ in range(dice.choice((1, 1, 2, 5))):
            spoil(dice.choice(records), dice)

    return rewritten(sound, target, change)
