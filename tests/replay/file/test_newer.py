"""Recordings of a release that knows more than this one: announced, read as far as they go, and sound.

The future is forged of a golden recording: its definition gets more fields, a value of an enum, a command and a kind of
record, and its records have them.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet

import replay
from recorder.mcap_writer import McapWriter
from recorder.records import TOPICS, Envelope, Mutation, Task, format_number, known_definitions, log_pb2
from replay.cli.main import main
from replay.restore.verify import verify

if TYPE_CHECKING:
    from collections.abc import Callable

    from google.protobuf.message import Message

GOLDEN = Path(__file__).parents[1] / "golden" / "0.1.0.mcap"


def future_definition() -> FileDescriptorProto:
    """The definition of records, as a later release might have it."""
    definition = FileDescriptorProto()
    log_pb2.DESCRIPTOR.CopyToProto(definition)
    messages = {message.name: message for message in definition.message_type}
    add_field(messages["Task"], "mood", 200)
    add_field(messages["BodyState"], "temperature", 200)
    add_field(messages["Run"], "weather", 200)
    push = definition.message_type.add(name="PushBody")
    add_field(push, "body", 1)
    pushed = messages["Mutation"].field.add(
        name="push_body", number=200, type=FieldDescriptorProto.TYPE_MESSAGE, label=FieldDescriptorProto.LABEL_OPTIONAL
    )
    pushed.type_name, pushed.oneof_index = ".pycram.log.v1.PushBody", 0
    status = next(enum for enum in messages["Task"].enum_type if enum.name == "Status")
    status.value.add(name="BORED", number=99)
    thought = definition.message_type.add(name="Thought")
    thought.field.extend(messages["Envelope"].field)
    add_field(thought, "text", 16)
    return definition


def add_field(message: DescriptorProto, name: str, number: int) -> None:
    message.field.add(
        name=name, number=number, type=FieldDescriptorProto.TYPE_STRING, label=FieldDescriptorProto.LABEL_OPTIONAL
    )


def fields_only(name: str, record: Any) -> tuple[str, Message]:
    """A record with all that a later release may add, but for commands and kinds."""
    if name == "Task":
        record.mood = "fine"
    elif name == "Run":
        record.weather = "rain"
    elif name == "Mutation":
        for state in record.effect.bodies:
            state.temperature = "warm"
    return name, record


def forge(file: Path, change: Callable[[str, Any], tuple[str, Message]] = fields_only, release: str = "9.0.0") -> Path:
    """Writes a golden recording as a later release would have written it."""
    definition = future_definition()
    pool = descriptor_pool.DescriptorPool()
    pool.Add(definition)
    classes = {
        each.name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"pycram.log.v1.{each.name}"))
        for each in definition.message_type
    }
    number = sum(
        1 + len(each.field) + sum(len(enum.value) for enum in each.enum_type) for each in definition.message_type
    )
    schema = FileDescriptorSet(file=[definition]).SerializeToString()
    with file.open("wb") as stream, replay.open(GOLDEN) as log:
        writer = McapWriter(stream, f"pycram {release}")
        writer.add_metadata("pycram", dict(log.metadata) | {"pycram": release, "format": str(number)})
        for name, content in log.assets.items():
            writer.add_attachment(0, name, "", content)
        channels: dict[str, int] = {}
        for record in log.records():
            name = type(record).__name__
            name, later = change(name, classes[name].FromString(record.SerializeToString()))
            if type(later).__name__ != type(record).__name__ and name == "Thought":
                later = classes[name](seq=record.seq, wall_time_ns=record.wall_time_ns, text="hm")
            if name not in channels:
                topics = {kind.__name__: topic for kind, topic in TOPICS.items()} | {"Thought": "/thought"}
                channels[name] = writer.add_channel(
                    topics[name], "protobuf", writer.add_schema(f"pycram.log.v1.{name}", "protobuf", schema)
                )
            writer.add_messages([(channels[name], record.seq, record.wall_time_ns, later.SerializeToString())])
        writer.finish()
    return file


@pytest.fixture(scope="module")
def future(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return forge(tmp_path_factory.mktemp("future") / "future.mcap")


def thinking(name: str, record: Any) -> tuple[str, Any]:
    """One query less, and in its place a thought."""
    return ("Thought", None) if record.seq == next_query() else fields_only(name, record)


def next_query() -> int:
    with replay.open(GOLDEN) as log:
        return next(record.seq for record in log.records("query"))


@pytest.mark.parametrize("verb", ["info", "log", "tree", "show 9", "state last", "diff 9 last", "blame milk", "why"])
def test_a_newer_recording_is_announced_and_read(future: Path, capsys: pytest.CaptureFixture[str], verb: str) -> None:
    name, *rest = verb.split()
    assert main([name, str(GOLDEN), *rest]) == 0
    expected = capsys.readouterr()
    assert not expected.err
    assert main([name, str(future), *rest]) == 0
    said = capsys.readouterr()
    assert re.fullmatch(r"pycram-replay: \S+future.mcap: written by PyCRAM 9.0.0, .*\n", said.err)
    assert "fields unknown here are ignored (" in said.err
    if name != "info":  # it names the file, and its version
        assert said.out == expected.out.replace(str(GOLDEN), str(future))


def test_what_is_unknown_is_named(future: Path) -> None:
    with replay.open(future) as log:
        assert log.complete
        assert log.newer is not None
        assert log.format > format_number() == len(known_definitions())
        assert set(log.newer.fields) == {
            "Task.mood", "Task.BORED", "BodyState.temperature", "Run.weather", "Mutation.push_body"
        }  # fmt: skip
        assert not log.newer.kinds
    with replay.open(GOLDEN) as log:
        assert log.newer is None
        assert log.format == 0


def test_unknown_fields_are_no_difference(future: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with replay.open(future) as log:
        verdict = verify(log)
    assert verdict.exact, verdict
    assert verdict.changes == 123
    assert main(["verify", str(future)]) == 0
    assert "written by PyCRAM 9.0.0" in capfd.readouterr().err


@pytest.mark.slow
def test_a_record_of_an_unknown_kind_keeps_its_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    step = next_query()
    file = forge(tmp_path / "future.mcap", thinking)
    assert main(["log", str(file), "--json"]) == 0
    output = capsys.readouterr()
    assert "for 1 kind of records only the envelope is read (Thought)" in output.err
    lines = [json.loads(line) for line in output.out.splitlines()]
    assert [line["step"] for line in lines] == list(range(146))
    assert (lines[step]["kind"], lines[step]["text"]) == (
        "unknown", "a record of a kind that this release doesn't know"
    )  # fmt: skip
    for verb in ("info", f"show {step}", "state last", "verify --static"):
        name, *rest = verb.split()
        assert main([name, str(file), *rest]) == 0, capsys.readouterr()
    with replay.open(file) as log:
        assert isinstance(log[step], Envelope)
        assert log.counts()["unknown"] == 1


def test_a_change_of_an_unknown_kind_leaves_its_effect(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What it did is on record: the state has it, and what comes after it is compared as far as that goes."""

    def pushing(name: str, record: Any) -> tuple[str, Any]:
        if name == "Mutation" and record.seq == 60:
            assert record.HasField("move_body")
            record.push_body.body = record.move_body.body
        return fields_only(name, record)

    file = forge(tmp_path / "future.mcap", pushing)
    with replay.open(file) as log, replay.open(GOLDEN) as golden:
        assert log[60].WhichOneof("command") is None  # type: ignore[union-attr]
        assert log.state_at("last").world().bodies["cereal"] == golden.state_at("last").world().bodies["cereal"]
        verdict = verify(log)
    assert verdict.sound, verdict
    assert not verdict.exact
    assert verdict.unknown == ("table",)
    assert main(["verify", str(file)]) == 0
    assert "a feature of a newer release changed table" in capsys.readouterr().out


def test_statuses_of_the_future_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def bored(name: str, record: Any) -> tuple[str, Any]:
        if name == "Task" and record.status == Task.SUCCEEDED:
            record.status = 99
        return fields_only(name, record)

    file = forge(tmp_path / "future.mcap", bored)
    assert main(["verify", "--static", str(file)]) == 0, capsys.readouterr()
    assert main(["log", str(file)]) == 0


def test_a_repaired_copy_keeps_what_is_unknown(future: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(future.read_bytes()[:-2000])
    assert main(["repair", str(cut), "-o", str(tmp_path / "whole.mcap")]) == 3
    with replay.open(tmp_path / "whole.mcap") as log:
        assert log.newer is not None
        tasks = [record.SerializeToString() for record in log.records(Task)]
        assert tasks
        assert all(b"fine" in task for task in tasks)


def test_unknown_fields_of_the_same_release_are_a_difference(tmp_path: Path) -> None:
    """No release of this format writes them."""
    file = forge(tmp_path / "x.mcap", release="0.1.0")
    content = file.read_bytes()
    with replay.open(file) as log:
        assert log.newer is not None, "its format tells"
        number = str(log.format).encode()
    same = str(format_number()).encode().rjust(len(number), b"0")
    file.write_bytes(
        content.replace(
            b"\x06\x00\x00\x00format\x03\x00\x00\x00" + number, b"\x06\x00\x00\x00format\x03\x00\x00\x00" + same
        )
    )
    with replay.open(file) as log:
        assert log.newer is None
        assert not verify(log).sound


def test_a_recording_of_now_has_the_format_of_now(small_log: Path) -> None:
    with replay.open(small_log) as log:
        assert log.format == format_number()
        assert log.newer is None
        assert list(log.records(Mutation))
