"""What PyCRAM writes is sound for every tool that reads MCAP: `mcap doctor` has nothing to complain of."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

import recorder
from pycram.bullet_world import BulletWorld, Object
from replay.cli.main import main
from tests.replay import hostile
from tests.replay.copies import CHUNK, MAGIC, container_records, zeroed
from tests.replay.doctor import diagnosis

if TYPE_CHECKING:
    from collections.abc import Callable

GOLDEN = Path(__file__).parents[1] / "golden"


def changed(file: Path, target: Path, change: Callable[[bytes], bytes]) -> Path:
    target.write_bytes(change(file.read_bytes()))
    return target


def without_chunk(content: bytes) -> bytes:
    return zeroed(content, *[extent for opcode, *extent in container_records(content) if opcode == CHUNK][8])


def test_the_doctor_accepts_what_is_recorded(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "x.mcap"), BulletWorld(name="table") as world:
        cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
        for number in range(120):
            cup.set_position([0, 0, number])
        world.simulate(0.1)
    assert diagnosis(tmp_path / "x.mcap") == []


@pytest.mark.parametrize("file", sorted(GOLDEN.rglob("*.mcap")), ids=lambda file: str(file.relative_to(GOLDEN)))
def test_the_doctor_accepts_what_releases_recorded(file: Path) -> None:
    assert diagnosis(file) == []


@pytest.mark.parametrize("damage", ["none", "a zeroed chunk", "cut off", "no index"])
def test_the_doctor_accepts_what_is_repaired(damage: str, tmp_path: Path) -> None:
    change: Callable[[bytes], bytes] = {
        "none": bytes,
        "a zeroed chunk": without_chunk,
        "cut off": lambda content: content[: len(content) * 2 // 3],
        "no index": lambda content: content[:-40],
    }[damage]
    file = changed(GOLDEN / "0.1.0.mcap", tmp_path / "x.mcap", change)
    if damage != "none":
        assert diagnosis(file)
    assert main(["repair", str(file), "-o", str(tmp_path / "sound.mcap")]) == (0 if damage == "none" else 3)
    assert diagnosis(tmp_path / "sound.mcap") == []


@pytest.mark.parametrize(
    ("kind", "field", "value", "complaint"),
    [
        (Header, "library", "", "Set the Header.library field"),
        (Header, "profile", "x", "not a well-known profile"),
        (Schema, "encoding", "", "Schema has empty Encoding"),
        (Schema, "id", 0, "Schema.ID 0 is reserved"),
        (Schema, "id", 1, "Two Schema records with same ID but different content"),
        (Channel, "schema_id", 99, "Encountered Channel with unknown Schema"),
        (Channel, "id", 1, "Two Channel records with same ID but different content"),
        (Channel, "id", 99, "Got a Message record for channel before a channel record"),
        (Chunk, "uncompressed_size", 1, "Uncompressed chunk data size"),
        (Chunk, "uncompressed_crc", 1, "invalid CRC"),
        (Chunk, "message_start_time", 1 << 40, "Chunk.message_start_time does not match"),
        (Chunk, "message_end_time", 1 << 40, "Chunk.message_end_time does not match"),
        (ChunkIndex, "chunk_start_offset", 8, "Chunk index points to offset"),
        (ChunkIndex, "chunk_length", 1, "Chunk index length mismatch"),
        (ChunkIndex, "message_start_time", 1 << 40, "Chunk has message start time"),
        (ChunkIndex, "message_end_time", 1 << 40, "Chunk has message end time"),
        (ChunkIndex, "compression", "lz4", "Chunk has compression"),
        (ChunkIndex, "compressed_size", 1, "Chunk has compressed size"),
        (ChunkIndex, "uncompressed_size", 1, "Chunk has uncompressed size"),
        (ChunkIndex, "message_index_length", 1, "another length of message indexes"),
        (ChunkIndex, "message_index_offsets", {}, "Chunk index names other message indexes"),
        (Statistics, "message_start_time", 1 << 40, "Statistics has message start time"),
        (Statistics, "message_end_time", 1 << 40, "Statistics has message end time"),
        (Statistics, "message_count", 1, "Statistics has message count 1"),
        (Statistics, "channel_message_counts", {1: 1}, "Statistics has message count for channel"),
        (Statistics, "schema_count", 99, "Statistics has schemas"),
        (Statistics, "channel_count", 99, "Statistics has channels"),
        (Statistics, "chunk_count", 99, "Statistics has chunks"),
        (Statistics, "attachment_count", 99, "Statistics has attachments"),
        (Statistics, "metadata_count", 99, "Statistics has metadata"),
        (AttachmentIndex, "data_size", 1, "an attachment isn't what its index says"),
        (AttachmentIndex, "offset", 8, "attachments aren't those of the index"),
        (MetadataIndex, "name", "x", "metadata isn't what its index says"),
        (SummaryOffset, "group_length", 1, "summary offsets don't cover the summary"),
        (SummaryOffset, "group_opcode", 1, "a summary offset names another group"),
        (DataEnd, "data_section_crc", 1, "invalid CRC of the data section"),
        (Footer, "summary_crc", 1, "invalid CRC of the summary"),
        (Footer, "summary_offset_start", 8, "summary offsets begin elsewhere"),
    ],
)
def test_the_doctor_finds_what_is_wrong(
    kind: type[McapRecord], field: str, value: Any, complaint: str, tmp_path: Path
) -> None:
    """Nobody who accepts everything."""
    with hostile.lying(kind, lambda record: setattr(record, field, value)):
        file = hostile.rewritten(GOLDEN / "0.1.0.mcap", tmp_path / "x.mcap")
    assert any(complaint in each for each in diagnosis(file)), diagnosis(file)


@pytest.mark.parametrize(
    ("place", "complaint"),
    [
        (9, "No MessageIndex record found for channel"),
        (15, "MessageIndex entry has another timestamp"),
        (23, "No MessageIndex entry found for message"),
    ],
)
def test_the_doctor_finds_what_is_wrong_with_an_index_of_messages(place: int, complaint: str, tmp_path: Path) -> None:
    """Its channel, or an entry's time or offset."""

    def change(content: bytes) -> bytes:
        at = next(start for opcode, start, _ in container_records(content) if opcode == Opcode.MESSAGE_INDEX) + place
        return content[:at] + bytes([content[at] ^ 0x40]) + content[at + 1 :]

    file = changed(GOLDEN / "0.1.0.mcap", tmp_path / "x.mcap", change)
    assert any(complaint in each for each in diagnosis(file)), diagnosis(file)


def with_chunk(content: bytes, change: Callable[[bytes], bytes], number: int = 0) -> bytes:
    """The content with something else in a chunk, whose sizes and checksum are right; what follows has moved."""
    start, end = [extent for opcode, *extent in container_records(content) if opcode == CHUNK][number]
    chunk = Chunk.read(ReadDataStream(io.BytesIO(content[start + 9 : end])))
    inside = change(zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=1 << 30))
    chunk.data, chunk.uncompressed_size = zstandard.ZstdCompressor().compress(inside), len(inside)
    chunk.uncompressed_crc = zlib.crc32(inside)
    builder = RecordBuilder()
    chunk.write(builder)
    return content[:start] + builder.end() + content[end:]


def undecompressible(content: bytes) -> bytes:
    at = content.index(zstandard.FRAME_HEADER)
    return zeroed(content, at, at + 4)


def longer_header(content: bytes) -> bytes:
    length = struct.unpack_from("<Q", content, 9)[0]
    return content[:9] + struct.pack("<Q", length + 1) + content[17 : 17 + length] + b"x" + content[17 + length :]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda content: content[:-8] + b"junk" + content[-8:], "Failed to read next token: more than the footer"),
        (lambda content: content.replace(b"pycram", b"pycra\xff", 1), "Failed to parse Header: UnicodeDecodeError"),
        (longer_header, "Failed to parse Header: its fields are shorter or longer"),
        (undecompressible, "Could not decompress"),
        (lambda content: with_chunk(content, lambda inside: inside[:-1]), "unexpected end of the chunk"),
        (lambda content: with_chunk(content, lambda inside: inside + b"\x05\x00"), "unexpected end of the chunk"),
        (lambda content: with_chunk(content, lambda inside: inside + b"\x10" + bytes(8)), "Illegal record in chunk"),
    ],
)
def test_the_doctor_finds_what_cannot_be_read(change: Callable[[bytes], bytes], complaint: str, tmp_path: Path) -> None:
    """Says so, instead of failing itself."""
    file = changed(GOLDEN / "0.1.0.mcap", tmp_path / "x.mcap", change)
    assert any(complaint in each for each in diagnosis(file)), diagnosis(file)


def test_the_doctor_accepts_statistics_of_what_is_repaired_from_chunks_whose_times_go_back(tmp_path: Path) -> None:
    """The copy keeps the order of chunks, so that times out of order are told, as a warning; all else is right."""

    def later(inside: bytes) -> bytes:
        extents = container_records(bytes(MAGIC) + inside)
        at = next(start for opcode, start, _ in extents if opcode == Opcode.MESSAGE) - MAGIC + 9 + 2 + 4
        time_ns = struct.unpack_from("<Q", inside, at)[0]
        return inside[:at] + struct.pack("<Q", time_ns + 10**15) + inside[at + 8 :]

    file = changed(GOLDEN / "0.1.0.mcap", tmp_path / "x.mcap", lambda content: with_chunk(content, later, 3))
    assert main(["repair", str(file), "-o", str(tmp_path / "sound.mcap")]) == 3
    assert set(diagnosis(tmp_path / "sound.mcap")) == {"Message.log_time is less than the latest log time"}
