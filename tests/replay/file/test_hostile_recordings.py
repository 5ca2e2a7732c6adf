"""A stranger's recording does no harm: whatever it says, a verb ends soon, with little memory, and opens nothing else."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import random
import struct
import tempfile
import zlib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import lz4.frame
import pytest
import zstandard
from google.protobuf.descriptor import FieldDescriptor
from mcap.data_stream import RecordBuilder
from mcap.records import AttachmentIndex, Chunk, ChunkIndex

import replay
import replay.cli.info
import replay.cli.repair
from pycram.models import store
from recorder.mcap_writer import FREE, MAX_RATIO, McapWriter
from recorder.packages import versions
from recorder.records import TOPICS, BodyState, Grid, Keyframe, Mutation, Picture, Query, Run, Task
from recorder.records.fold import FAR
from recorder.records.values import MAX_CHARACTERS, MAX_DIGITS, MAX_NESTING
from recorder.viewer.queries import MAX_PIXELS
from replay.cli.main import main
from replay.file.chunks import MAX_STEP
from replay.file.mcap_format import MAX_INFLATED, MAX_PARTS
from replay.state.integrity import MAX_DEPTH
from tests.measures import seeded
from tests.replay import forked, hostile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from mcap.records import McapRecord

    from recorder.records import Record

pytestmark = pytest.mark.slow

GOLDEN: Final = Path(__file__).parents[1] / "golden" / "0.1.0.mcap"
#: What is mutated: of every kind of record one of them has some.
CORPUS: Final = (GOLDEN, *(GOLDEN.parent / each / GOLDEN.name for each in ("reasons", "forks", "motions")))
ENGINE: Final = (["verify"], ["restore", "-20", "--json"], ["render", "-20", "-o", "x.png", "--size", "8x8"])
READING: Final = (
    ["info"],
    ["log"],
    ["log", "--json"],
    ["tree"],
    ["tree", "--json"],
    ["tree", "--svg"],
    ["tree", "--dot"],
    ["show", "30"],
    ["state", "last", "--json"],
    ["diff", "9", "last"],
    ["blame", "milk"],
    ["why"],
)
EVERY: Final = (*READING, *ENGINE, ["ask", "-20", "stable(milk)"])
USING: Final = (
    *ENGINE,
    ["restore", "-9", "--exact", "--json"],
    ["ask", "-8", "stable(milk)"],
    ["ask", "-8", "visible(milk, [1.5, 0, 0.5])"],
)


@pytest.fixture(scope="module", autouse=True)
def warm(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What a process does once, such as imports, it does before it forks; without, a verb takes twenty times as long."""
    folder = tmp_path_factory.mktemp("warm")
    versions()
    store.folder()
    with contextlib.redirect_stdout(io.StringIO()):
        for name, *rest in (*USING, *READING):
            assert main([name, str(GOLDEN), *placed(rest, folder)]) == 0
    gc.collect()
    gc.freeze()  # collecting in a fork would copy all of it


def placed(arguments: list[str], folder: Path) -> list[str]:
    """Name the files that a verb writes, which begin with an x, in a folder."""
    return [str(folder / each) if each.startswith("x.") else each for each in arguments]


def end(verb: list[str], file: Path, folder: Path) -> forked.Ended:
    name, *rest = verb
    return forked.run([name, str(file), *placed(rest, folder)], folder)


def check(file: Path, folder: Path, *verbs: list[str], damaged: bool = True, says: str = "") -> None:
    for verb in verbs:
        ended = end(verb, file, folder)
        assert ended.well, (verb, ended)
        if damaged:
            assert ended.code == 3, (verb, ended)
        assert says in ended.output, (verb, ended.output[-2000:])


def test_a_sound_copy_is_sound(tmp_path: Path) -> None:
    """What the others make of it is what they find."""
    sound = hostile.rewritten(GOLDEN, tmp_path / "x.mcap")
    check(sound, tmp_path, ["verify"], damaged=False, says="sound ")
    check(sound, tmp_path, ["info"], damaged=False, says="complete     yes")


# --- models -----------------------------------------------------------------------------------------------------------

CUBE: Final = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
STL: Final = b"\0" * 80 + struct.pack("<I12fH", 1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
ENTITIES: Final = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10 if n else "x" * 1000}">' for n in range(10))
MESHES: Final[dict[str, tuple[str, bytes]]] = {
    "far index": ("x.obj", CUBE + b"f 1 2 99999999\n"),
    "negative index": ("x.obj", CUBE + b"f -1 -2 -99999999\n"),
    "index in a long line": ("x.obj", CUBE + b"#" + b" " * 8190 + b"f 1 2 99999999\n"),
    "numbers that are none": ("x.obj", CUBE + b"v nan nan nan\nf 5 1 2\n"),
    "empty OBJ": ("x.obj", b"\n"),
    "materials elsewhere": ("x.obj", b"mtllib /etc/passwd\n" + CUBE),
    "empty file": ("x.stl", b""),
    "cut STL": ("x.stl", STL[:-9]),
    "lying STL": ("x.stl", STL[:80] + struct.pack("<I", 85_899_346) + STL[84:]),
    "far STL": ("x.stl", STL[:96] + struct.pack("<f", 3e38) + STL[100:]),
    "empty COLLADA": ("x.dae", b"<COLLADA/>"),
    "COLLADA of entities": ("x.dae", f"<!DOCTYPE a [{ENTITIES}]><COLLADA>&e9;</COLLADA>".encode()),
    "unknown type": ("x.vrml", b"x"),
}


@pytest.mark.parametrize("what", MESHES)
def test_a_mesh_that_would_end_the_process_is_damage(what: str, tmp_path: Path) -> None:
    name, content = MESHES[what]

    def change(records: list[Record], assets: dict[str, bytes]) -> None:
        mesh = next(key for key in assets if key.endswith(".obj"))
        hostile.replace_file(records, assets, mesh, content, name)

    check(hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change), tmp_path, *ENGINE)


def urdf(change: Callable[[bytes, dict[str, bytes]], bytes]) -> Callable[[list[Record], dict[str, bytes]], None]:
    def changed(records: list[Record], assets: dict[str, bytes]) -> None:
        model = next(key for key in assets if key.endswith("carton.urdf"))
        text = change(assets[model], assets)
        assert text != assets[model]
        hostile.replace_file(records, assets, model, text)

    return changed


def named(text: bytes, name: str) -> bytes:
    """A model with another name of its first mesh."""
    before, _, rest = text.partition(b'filename="')
    return before + b'filename="' + name.encode() + b'"' + rest.partition(b'"')[2]


@pytest.mark.parametrize(
    "name", ["{folder}/there.obj", "../there.obj", "there.obj", "http://127.0.0.1:9/x.obj", "{folder}/pipe.obj"]
)
def test_a_model_names_no_file_but_those_of_its_recording(name: str, tmp_path: Path) -> None:
    (tmp_path / "there.obj").write_bytes(CUBE)
    os.mkfifo(tmp_path / "pipe.obj")
    model = urdf(lambda text, _: named(text, name.format(folder=tmp_path)))
    check(
        hostile.rewritten(GOLDEN, tmp_path / "x.mcap", model),
        tmp_path,
        *ENGINE,
        says="a file that the recording doesn't have",
    )


def test_a_model_names_no_file_of_another_body(tmp_path: Path) -> None:
    """It is in the recording, but the record that loads the body doesn't list it."""
    other = "plan.py"
    model = urdf(lambda text, assets: named(text, next(key for key in assets if key.endswith(other))))
    check(
        hostile.rewritten(GOLDEN, tmp_path / "x.mcap", model),
        tmp_path,
        *ENGINE,
        says="a file that the recording doesn't have",
    )


TEXTS: Final[dict[str, Callable[[bytes], bytes]]] = {
    "no number": lambda text: text.replace(b'<mass value="', b'<mass value="nan'),
    "a huge number": lambda text: text.replace(b'xyz="', b'xyz="1e300 0 0" old="'),
    "no XML": lambda text: text[:-20],
    "entities": lambda text: f"<!DOCTYPE robot [{ENTITIES}]>".encode() + text.replace(b"</robot>", b"&e9;</robot>"),
    "a texture": lambda text: text.replace(
        b"<material ", b'<material><texture filename="/dev/zero"/></material><material '
    ),
    "deep": lambda text: text.replace(b"<geometry>", b"<geometry>" * 50_000).replace(
        b"</geometry>", b"</geometry>" * 50_000
    ),
    "another encoding": lambda text: b'<?xml version="1.0" encoding="utf-16"?>' + text,
    "many joints": lambda text: text.replace(
        b"</robot>",
        b"".join(
            b'<link name="l%d"/><joint name="j%d" type="fixed"><parent link="l%d"/><child link="l%d"/></joint>'
            % (n, n, n - 1, n)
            for n in range(1, 300)
        ).replace(b'"l0"', b'"carton"')
        + b"</robot>",
    ),
}


@pytest.mark.parametrize("what", TEXTS)
def test_a_model_that_makes_no_sense_is_damage(what: str, tmp_path: Path) -> None:
    model = urdf(lambda text, _: TEXTS[what](text))
    check(hostile.rewritten(GOLDEN, tmp_path / "x.mcap", model), tmp_path, *ENGINE)


@pytest.mark.parametrize("path", ["..", "a/..", "x\0y.obj", "x" * 300 + ".obj"])
def test_a_file_with_a_name_that_is_none_is_damage(path: str, tmp_path: Path) -> None:
    def change(records: list[Record], assets: dict[str, bytes]) -> None:
        mesh = next(key for key in assets if key.endswith(".obj"))
        hostile.replace_file(records, assets, mesh, assets[mesh], path.rpartition("/")[2])

    check(hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change), tmp_path, ENGINE[1])


@pytest.mark.parametrize(
    "name", ["a/../../x.py", "/x.py", "../x.py", "a/x\0.py", "a/\x1b[2J.py", "a/" + "x" * 300 + ".py"]
)
def test_the_plan_s_files_are_written_where_they_are_wanted(name: str, tmp_path: Path) -> None:
    def change(_: list[Record], assets: dict[str, bytes]) -> None:
        assets[name] = b"x"

    folder = tmp_path / "x.source"
    folder.mkdir()
    file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change)
    check(file, tmp_path, ["source"], ["source", "-o", "x.source"], damaged=False)
    assert all(each.name.isprintable() for each in folder.iterdir())
    assert not (tmp_path / "x.py").exists()


# --- bombs ------------------------------------------------------------------------------------------------------------


def packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


class Bomb(McapWriter):
    """A writer whose next chunk is what it isn't."""

    def inflate(self, compression: str, data: bytes, size: int, crc: int = 1) -> None:
        chunk = Chunk(compression, data, 0, 0, crc, size)
        at, content = self.size, packed(chunk)
        self._write(content)
        self._chunks.append(ChunkIndex(len(content), at, compression, len(data), 0, 0, {1: 0, 2: 0}, 0, size))


MEGABYTE: Final = 1 << 20
GIGABYTE: Final = 1 << 30
BOMBS: Final[dict[str, Callable[[], tuple[str, bytes, int]]]] = {
    "as it claims": lambda: ("zstd", bomb(), GIGABYTE),
    "more than it claims": lambda: ("zstd", bomb(), 1000),
    "without a size": lambda: ("zstd", unsized(), 1000),
    "lz4": lambda: ("lz4", lz4.frame.compress(bytes(GIGABYTE // 4)), 1000),
    "lz4, as it claims": lambda: ("lz4", lz4.frame.compress(bytes(GIGABYTE // 4)), GIGABYTE // 4),
    "not compressed": lambda: ("", b"x" * 1000, GIGABYTE),
    "unknown": lambda: ("brotli", b"x" * 1000, 1000),
}


@cache
def bomb() -> bytes:
    return zstandard.compress(bytes(GIGABYTE))


def unsized() -> bytes:
    compressor = zstandard.ZstdCompressor(write_content_size=False)
    return compressor.compress(bytes(GIGABYTE // 4))


@pytest.mark.parametrize("what", BOMBS)
def test_a_chunk_inflates_to_no_more_than_it_claims_and_that_is_bounded(what: str, tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with file.open("wb") as stream:
        writer = Bomb(stream, "pycram")
        begin(writer)
        writer.inflate(*BOMBS[what]())
        writer.flush()
        writer.finish()
    check(file, tmp_path, ["info"], ["log"], says="chunk 1 is damaged")
    file.write_bytes(file.read_bytes()[:-30])  # without an index: scanned
    check(file, tmp_path, ["info"], says="chunk 1 is damaged")


def begin(writer: McapWriter) -> None:
    run, task = (writer.add_schema(kind.DESCRIPTOR.full_name, "protobuf", b"") for kind in (Run, Task))
    writer.add_channel("/run", "protobuf", run)
    writer.add_channel("/task", "protobuf", task)
    writer.add_messages([(1, 0, 0, Run(phase=Run.STARTED, name="x", wall_time_ns=1).SerializeToString())])
    writer.flush()


@pytest.mark.costly
def test_chunks_inflate_to_no_more_than_recordings_do(tmp_path: Path) -> None:
    """Each is as large as a recorder's; a hundred of them have 100 MB of tasks in a few kB."""
    file = tmp_path / "x.mcap"
    payload = Task(seq=1, task=1, phase=Task.STARTED).SerializeToString()
    message = struct.pack("<BQHIQQ", 5, 22 + len(payload), 2, 1, 1, 1) + payload
    chunk = message * (MEGABYTE // len(message))
    with file.open("wb") as stream:
        writer = Bomb(stream, "pycram")
        begin(writer)
        for _ in range(100):
            writer.inflate("zstd", zstandard.compress(chunk), len(chunk), zlib.crc32(chunk))
        writer.finish()
    assert file.stat().st_size < MEGABYTE / 10
    check(file, tmp_path, ["info"], ["tree"], ["why"], says="inflate to more than")


def message(channel: int, step: int, payload: bytes) -> bytes:
    return struct.pack("<BQHIQQ", 5, 22 + len(payload), channel, step, 1, 1) + payload


def filler(writer: McapWriter, size: int) -> None:
    """Make a file larger, so that its chunks may be."""
    writer.add_attachment(0, "0/filler", "", random.Random(0).randbytes(size))


@cache
def large_chunk(one: bytes) -> tuple[bytes, int, int]:
    """60 MB of one message: compressed, how long it is, and its checksum."""
    chunk = one * (60 * MEGABYTE // len(one))
    return zstandard.compress(chunk), len(chunk), zlib.crc32(chunk)


@pytest.mark.parametrize("crc", ["right", "wrong"])
@pytest.mark.parametrize("index", ["", "names one chunk 5,000 times", "is missing"])
@pytest.mark.parametrize("library", ["pycram", "another"])
def test_chunks_that_are_too_much_are_not_inflated(library: str, index: str, crc: str, tmp_path: Path) -> None:
    """60 MB each; whoever reads them all, to count, to sort or to find them broken, would take minutes."""
    file = tmp_path / "x.mcap"
    one = message(2, 1, Task(seq=1, task=1, phase=Task.STARTED).SerializeToString())
    compressed, size, right = large_chunk(one)
    with file.open("wb") as stream:
        writer = Bomb(stream, library)
        begin(writer)
        for _ in range(1 if "5,000" in index else 60):
            writer.inflate("zstd", compressed, size, right if crc == "right" else 1)
        writer._chunks += writer._chunks[-1:] * (5000 if "5,000" in index else 0)
        writer.finish()
    if "missing" in index:
        file.write_bytes(file.read_bytes()[:-60])
    check(file, tmp_path, ["info"], ["log"], says="inflate to more than")


@pytest.mark.costly
@pytest.mark.parametrize("table", ["_chunks", "_attachments", "_metadata"])
def test_an_index_that_names_the_same_very_often_harms_nobody(
    table: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To read each is to read a megabyte thousands of times."""

    def change(_: list[Record], assets: dict[str, bytes]) -> None:
        assets["0/filler"] = random.Random(0).randbytes(MEGABYTE)

    def finish(writer: McapWriter) -> None:
        writer.flush()
        setattr(writer, table, getattr(writer, table) * 2000)
        McapWriter.finish(writer)

    monkeypatch.setattr(hostile, "McapWriter", type("Lying", (McapWriter,), {"finish": finish}))
    file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change, {"filler": "x" * MEGABYTE})
    check(file, tmp_path, ["info"])
    check(file, tmp_path, ["state", "last"], damaged=False)


@pytest.mark.costly
def test_records_in_disorder_are_read_once(tmp_path: Path) -> None:
    """Neighbouring steps are in other chunks, of which each takes a while to inflate, and another program wrote it."""
    file, chunks, each = tmp_path / "x.mcap", 20, 500
    picture = bytes(2000)
    with file.open("wb") as stream:
        writer = Bomb(stream, "another")
        begin(writer)
        for first in range(1, chunks + 1):
            records = [
                Task(seq=step, task=step, phase=Task.STARTED, kind="motion", parameters=[{"json": picture.decode()}])
                for step in range(first, chunks * each, chunks)
            ]
            content = b"".join(message(2, record.seq, record.SerializeToString()) for record in records)
            writer.inflate("zstd", zstandard.compress(content), len(content), zlib.crc32(content))
        writer._counts[2] = chunks * each - 1
        filler(writer, MEGABYTE)
        writer.finish()
    check(file, tmp_path, ["info"], ["tree"], damaged=False)
    with replay.open(file) as log:
        assert [record.seq for record in log] == list(range(chunks * each))


@pytest.mark.costly
@pytest.mark.parametrize(
    ("count", "size"), [pytest.param(1, 60 * MEGABYTE, marks=pytest.mark.long), (2, MEGABYTE // 2)]
)
def test_empty_parts_take_no_more_memory_than_others(count: int, size: int, tmp_path: Path) -> None:
    """Each takes three bytes in the file, and a hundred in memory."""
    file, bodies = tmp_path / "x.mcap", b"\xa2\x01\x00"
    assert Keyframe.FromString(bodies).bodies, "the field's number, and no bytes"
    with file.open("wb") as stream:
        writer = Bomb(stream, "pycram")
        begin(writer)
        schema = writer.add_schema(Keyframe.DESCRIPTOR.full_name, "protobuf", b"")
        channel = writer.add_channel("/keyframe", "protobuf", schema)
        writer.flush()
        for step in range(1, count + 1):
            payload = Keyframe(seq=step, world="w").SerializeToString() + bodies * (size // len(bodies))
            content = message(channel, step, payload)
            writer.inflate("zstd", zstandard.compress(content), len(content), zlib.crc32(content))
        filler(writer, 2 * MEGABYTE)
        writer.finish()
    for verb in (["info"], ["log"], ["state", "0"], ["repair", "-o", "x.sound.mcap"]):
        check(file, tmp_path, verb, damaged=count == 1, says="parts" if count == 1 else "")


# --- what records say -------------------------------------------------------------------------------------------------


def first(records: list[Record], kind: type[Any]) -> Any:
    return next(record for record in records if type(record) is kind)


def tasks(records: list[Record], count: int) -> None:
    """Tasks in each other in place of what the plan did."""
    start = first(records, Run)
    records[1:] = [
        Task(
            seq=n,
            task=n,
            parent=n - 1,
            phase=Task.STARTED,
            status=Task.RUNNING,
            name=f"t{n}",
            kind="motion",
            wall_time_ns=start.wall_time_ns,
        )
        for n in range(1, count)
    ]


def all_fields(message: Any, kind: int, value: Any) -> None:
    for part in hostile.parts(message):
        for field, held in part.ListFields():
            if field.cpp_type == kind:
                if hasattr(held, "append"):
                    held[:] = [value] * len(held)
                else:
                    setattr(part, field.name, value)


def changed(kind: type[Any], **fields: object) -> Callable[[list[Record], dict[str, bytes]], None]:
    """Fields of the first record of a kind, and its place in the recording, are others."""

    def change(records: list[Record], _: dict[str, bytes]) -> None:
        for name, value in fields.items():
            setattr(first(records, kind), name, value)

    return change


def every(kind: int, value: object) -> Callable[[list[Record], dict[str, bytes]], None]:
    """All numbers, texts, ... of what moves and asks are another one."""

    def change(records: list[Record], _: dict[str, bytes]) -> None:
        for record in records[6:]:
            all_fields(record, kind, value)

    return change


DOUBLE, TEXT, ENUM = FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_STRING, FieldDescriptor.CPPTYPE_ENUM


def jsons(text: str) -> Callable[[list[Record], dict[str, bytes]], None]:
    """Every value that is JSON is a text."""

    def change(records: list[Record], _: dict[str, bytes]) -> None:
        for record in records:
            for part in hostile.parts(record):
                for field, _held in part.ListFields():
                    if field.name == "json" or field.name.endswith("_json"):
                        setattr(part, field.name, text)

    return change


def swapped(records: list[Record], _: dict[str, bytes]) -> None:
    """Times that are 3e9 s apart."""
    for record in records[70:]:
        record.wall_time_ns += 3_000_000_000_000_000_000
        record.monotonic_ns += 3_000_000_000_000_000_000


def circular(records: list[Record], _: dict[str, bytes]) -> None:
    """Every task is its own part, and caused itself."""
    for record in records:
        record.cause = record.seq
        if isinstance(record, Task):
            record.parent = record.task


SAID: Final[dict[str, Callable[[list[Record], dict[str, bytes]], None]]] = {
    "tasks in each other": lambda records, _: tasks(records, 20_000),
    "unknown phases": every(ENUM, 99),
    "negative phases": every(ENUM, -1),
    "deep JSON": jsons("[" * 100_000),
    "sound but deep JSON": jsons("[" * 900 + "]" * 900),
    "JSON that takes long to look through": jsons("[" * 101 + '"' + '\\"' * 50_000),
    "long rows of digits": jsons(("1" * 299 + " ") * 2000),
    "circles": circular,
    "large numbers": jsons("9" * 4200),
    "more digits than Python reads": jsons("9" * 5000),
    "numbers that JSON doesn't have": jsons("[NaN, 1e999, -Infinity]"),
    "no JSON": jsons("{'a': object}"),
    "another type": jsons('{"object": [], "pairs": {"": 3}, "share": "x"}'),
    "times": swapped,
    "NaN": every(DOUBLE, float("nan")),
    "far": every(DOUBLE, 1e30),
    "too far": every(DOUBLE, 1e300),
    "squares beyond floats": every(DOUBLE, 5e307),
    "infinite": every(DOUBLE, float("inf")),
    "control characters": every(TEXT, "\x1b[2J\u202e\x00"),
    "long": every(TEXT, "x" * 100_000),
    "nothing": every(TEXT, ""),
}


def shared(cases: Iterable[Any]) -> pytest.MarkDecorator:
    """Share the verbs out among a case's four tests, of which ``make test`` has one: the next verbs for each case."""
    return pytest.mark.parametrize(
        ("case", "verbs"),
        [
            pytest.param(case, EVERY[part::8], id=f"{case}-{part}", marks=[pytest.mark.long] * (part != number % 8))
            for number, case in enumerate(cases)
            for part in range(8)
        ],
    )


@pytest.mark.measure("what records say, by every verb")
@shared(SAID)
def test_what_records_say_harms_nobody(case: str, verbs: Sequence[list[str]], tmp_path: Path) -> None:
    def change(records: list[Record], assets: dict[str, bytes]) -> None:
        SAID[case](records, assets)
        assets["0/filler"] = random.Random(0).randbytes(MEGABYTE)  # so that the texts aren't too much for the file

    file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change)
    check(file, tmp_path, *verbs, damaged=False)


@pytest.mark.parametrize("number", [float("inf"), float("nan"), 5e307])
@pytest.mark.parametrize("field", ["orientation", "position", "velocity", "joint_positions", "joint_velocities"])
def test_a_number_of_a_keyframe_that_is_none_is_damage(field: str, number: float, tmp_path: Path) -> None:
    changed = []

    def change(records: list[Record], _: dict[str, bytes]) -> None:
        for record in records:
            if isinstance(record, Keyframe):
                for body in record.bodies:
                    numbers = getattr(body, field)
                    if numbers:
                        numbers[0] = number
                        changed.append(body.body)

    file = hostile.rewritten(GOLDEN.parent / "motions" / GOLDEN.name, tmp_path / "x.mcap", change)
    assert changed
    check(file, tmp_path, ["verify", "--static"], ["state", "last"], ["info"], damaged=False)


@pytest.mark.measure("steps that can't be, by every verb")
@shared([(place, number) for place in (3, -1) for number in (-1, 2**63 - 1, 2**39)])
def test_a_step_that_can_not_be_is_damage(case: tuple[int, int], verbs: Sequence[list[str]], tmp_path: Path) -> None:
    place, number = case

    def change(records: list[Record], _: dict[str, bytes]) -> None:
        records[place].seq = number

    file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change)
    check(file, tmp_path, ["info"], ["log"])
    check(file, tmp_path, *verbs, damaged=False)


@pytest.mark.parametrize(
    "values", [{"life": "9" * 5000, "world": "w"}, {"plan": "x" * 200_000}, {"pybullet": "9" * 5000}]
)
def test_metadata_of_many_digits_harms_nobody(values: dict[str, str], tmp_path: Path) -> None:
    file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", metadata=values, channels=values)
    check(file, tmp_path, ["info"], ["log"], ["state", "last"], damaged=False)


PLACES: Final = (0, 8, 2**31, 2**62, 2**64 - 1)


@pytest.mark.parametrize(
    ("kind", "field"),
    [
        (ChunkIndex, "offset"),
        pytest.param(ChunkIndex, "length", marks=pytest.mark.costly),
        pytest.param(AttachmentIndex, "offset", marks=pytest.mark.costly),
        (AttachmentIndex, "length"),
    ],
)
def test_an_index_that_lies_harms_nobody(kind: type[Any], field: str, tmp_path: Path) -> None:
    """The summary's checksum is right."""
    name = {ChunkIndex: {"offset": "chunk_start_offset", "length": "chunk_length"}}.get(kind, {}).get(field, field)
    for place in PLACES:
        with hostile.lying(kind, lambda index, place=place: setattr(index, name, place)):
            file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap")
        check(file, tmp_path, ["info"], damaged=field == "offset")
        check(file, tmp_path, ["log"], ["state", "last"], ENGINE[1], damaged=False)


def test_a_simulation_of_years_is_damage(tmp_path: Path) -> None:
    def change(records: list[Record], _: dict[str, bytes]) -> None:
        record = next(record for record in records if isinstance(record, Mutation) and record.HasField("simulate"))
        record.simulate.steps = 2**62

    file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change)
    check(file, tmp_path, ["verify"], ["restore", "-9", "--exact", "--json"], says="and ends at")


@pytest.mark.parametrize("deeper", [0, 1])
def test_tasks_in_each_other_have_one_verdict(deeper: int, tmp_path: Path) -> None:
    file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", lambda records, _: tasks(records, MAX_DEPTH + deeper + 1))
    says = f"nested more than {MAX_DEPTH} levels deep" if deeper else ""
    check(file, tmp_path, ["verify", "--static"], ["verify"], ["tree"], damaged=bool(deeper), says=says)


@pytest.mark.parametrize("far", [9e8, 1e30, float("nan")])
def test_a_question_about_what_is_far_away_ends(far: float, tmp_path: Path) -> None:
    """The engine's own loops can't be ended."""

    def change(records: list[Record], _: dict[str, bytes]) -> None:
        for state in (part for part in hostile.parts(records[-8]) if isinstance(part, BodyState) and part.position):
            state.position[0] = far

    file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change)
    with replay.open(file) as log:
        moved = next(iter(log[len(log) - 8].effect.bodies)).body
    for question in (f"stable({moved})", f"visible({moved}, [1.5, 0, 0.5])", f"contact({moved}, floor)"):
        check(file, tmp_path, ["ask", "-8", question], damaged=far != 9e8)


def test_a_picture_is_no_larger_than_it_says(tmp_path: Path) -> None:
    pixels = zlib.compress(bytes(GIGABYTE // 4), level=1)
    for width, height in ((4, 4), (2**31 - 1, 2**31 - 1), (-1, -1), (0, 0)):

        def change(records: list[Record], _: dict[str, bytes], size: tuple[int, int] = (width, height)) -> None:
            query = first(records, Query)
            query.picture.CopyFrom(Picture(width=size[0], height=size[1], bodies=["milk"], pixels=pixels))

        file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change)
        check(file, tmp_path, ["view", "--save", "x.rrd"], damaged=(width, height) != (4, 4))


def test_a_map_of_places_is_no_larger_than_it_says(tmp_path: Path) -> None:
    scores = zlib.compress(bytes(GIGABYTE // 4), level=1)
    for width, height in ((4, 4), (2**31 - 1, 2**31 - 1), (-1, -1), (0, 0)):

        def change(records: list[Record], _: dict[str, bytes], size: tuple[int, int] = (width, height)) -> None:
            grid = Grid(origin=[0, 0, 0], resolution=0.05, width=size[0], height=size[1], scores=scores)
            first(records, Query).grid.CopyFrom(grid)

        file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change)
        check(file, tmp_path, ["view", "--save", "x.rrd"], damaged=(width, height) != (4, 4))


def test_an_error_of_our_own_is_said_as_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing that a file says may lead here; where it does, the traceback is kept for us."""

    def broken(*_: object) -> int:
        raise ZeroDivisionError("nobody foresaw it")

    monkeypatch.setattr(replay.cli.info, "run", broken)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert main(["info", str(GOLDEN)]) == 4
    output = capsys.readouterr()
    (kept,) = tmp_path.glob("pycram-replay-*.txt")
    assert "an internal error of PyCRAM" in output.err
    assert str(kept) in output.err
    assert "Traceback" not in output.err
    assert "nobody foresaw it" in kept.read_text()
    assert "Traceback" in kept.read_text()


def test_the_bounds_are_those_of_the_page() -> None:
    page = (Path(__file__).parents[3] / "docs" / "guides" / "damaged_recordings.md").read_text()
    for bound in (
        f"{MAX_INFLATED >> 20} MiB",
        f"{MAX_RATIO} times the file, or {FREE >> 20} MiB",
        f"2^{MAX_STEP.bit_length() - 1}",
        f"| 2^{MAX_PARTS.bit_length() - 1};",
        f"up to {FAR:.0e} m, rad".replace("+0", ""),
        f"{MAX_DEPTH:,} |",
        f"2^{MAX_PIXELS.bit_length() - 1}",
        f"more than {MAX_DIGITS} digits",
        f"more than 2^{MAX_CHARACTERS.bit_length() - 1} characters",
        f"more than {MAX_NESTING} deep",
    ):
        assert bound in page


# --- anything ---------------------------------------------------------------------------------------------------------


def test_empty_parts_are_shown(tmp_path: Path) -> None:
    """What a mutation leaves of a state in a long list of them."""

    def change(records: list[Record], _: object) -> None:
        mutation = next(record for record in records if isinstance(record, Mutation) and record.effect.bodies)
        mutation.effect.bodies.extend([BodyState(), BodyState()])

    file = hostile.rewritten(GOLDEN, tmp_path / "x.mcap", change)
    with replay.open(file) as log:
        step = next(record.seq for record in log if isinstance(record, Mutation) and len(record.effect.bodies) > 2)
    check(file, tmp_path, ["show", str(step)], damaged=False, says="- {}")


def test_the_corpus_has_every_kind_of_record() -> None:
    kinds, parts = set(), set()
    for file in (*CORPUS, GOLDEN.parent / "checks" / GOLDEN.name):
        with replay.open(file) as log:
            kinds |= {type(record) for record in log}
            parts |= {part.DESCRIPTOR.name for record in log for part in hostile.parts(record)}
            parts |= {task.kind for task in log.records(Task)}
    assert kinds == set(TOPICS)
    assert {"Origin", "Restore", "SavedBody", "projection", "in-thread", "Candidate", "Decision", "Following"} <= parts


@seeded("mutations of small recordings", range(20_000), 10, always=8 if "CI" in os.environ else 1)
def test_mutations_harm_nobody(seeds: range, tmp_path: Path) -> None:
    """Each through a verb that uses the engine and two that only read."""
    for seed in seeds:
        file = hostile.mutated(CORPUS[seed % len(CORPUS)], tmp_path / "x.mcap", seed)
        dice = random.Random(seed)
        for verb in (dice.choice(USING), *dice.sample(READING, 2)):
            ended = end(verb, file, tmp_path)
            assert ended.well, (seed, verb, ended)
