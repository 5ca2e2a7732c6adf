"""Other people's tools read a recording with public readers, and find its facts."""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.unknown_fields import UnknownFieldSet
from mcap.reader import make_reader
from rerun.chunk import McapReader

from replay.cli.main import main as replay_command

if TYPE_CHECKING:
    from collections.abc import Callable

    import pyarrow as pa
    from conftest import Headless
    from google.protobuf.message import Message
    from mcap.records import Channel, Message as Sent, Schema

pytestmark = pytest.mark.slow

REPO = Path(__file__).parents[3]
RECORDS = (
    "/run",
    "/task",
    "/mutation",
    "/event",
    "/query",
    "/output",
)  # of the demos; there is nothing on other channels


@pytest.fixture(scope="module", params=["set_the_table", "fails_to_reach"])
def log(request: pytest.FixtureRequest, recorded_demo: Callable[[str], Path]) -> Path:
    """A recording of a demo."""
    return recorded_demo(request.param)


@cache
def _message_type(name: str, definitions: bytes) -> type[Message]:
    """A type of messages as a file defines it."""
    pool = descriptor_pool.DescriptorPool()
    for described in FileDescriptorSet.FromString(definitions).file:
        pool.Add(described)  # refuses a file that imports one which isn't there yet
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


class Stranger:
    """Somebody who knows MCAP and protobuf, and nothing of us."""

    def __init__(self, file: Path) -> None:
        with file.open("rb") as opened:
            reader = make_reader(opened)
            self.messages = [(channel, sent, self._read(schema, sent)) for schema, channel, sent in self._sent(reader)]

    @staticmethod
    def _sent(reader: Any) -> list[tuple[Schema, Channel, Sent]]:
        return list(reader.iter_messages())

    @staticmethod
    def _read(schema: Schema, sent: Sent) -> Message:
        assert schema.encoding == "protobuf"
        return _message_type(schema.name, schema.data).FromString(sent.data)

    def on(self, topic: str) -> list[tuple[Sent, Any]]:
        return [(sent, message) for channel, sent, message in self.messages if channel.topic == topic]


@pytest.fixture(scope="module")
def stranger(log: Path) -> Stranger:
    return Stranger(log)


@pytest.mark.costly
def test_every_message_is_decoded_with_the_file_s_own_definitions(stranger: Stranger) -> None:
    topics = {channel.topic for channel, _, _ in stranger.messages}
    assert {"/run", "/task", "/mutation", "/query", "/output", "/tf", "/log"} <= topics <= {*RECORDS, "/tf", "/log"}
    for channel, sent, message in stranger.messages:
        assert channel.message_encoding == "protobuf"
        assert not len(UnknownFieldSet(message)), "no field is left out of its definition"
        if channel.topic in RECORDS:
            assert message.seq == sent.sequence
            assert message.wall_time_ns == sent.log_time
    steps = [message.seq for channel, _, message in stranger.messages if channel.topic in RECORDS]
    assert sorted(steps) == list(range(len(steps))), "each record, once"


def test_frames_form_one_tree_and_times_increase(stranger: Stranger) -> None:
    parents: dict[str, str] = {}
    before = 0.0
    for sent, message in stranger.on("/tf"):
        for frame in message.transforms:
            assert parents.setdefault(frame.child_frame_id, frame.parent_frame_id) == frame.parent_frame_id
            rotation = frame.rotation
            assert rotation.x**2 + rotation.y**2 + rotation.z**2 + rotation.w**2 == pytest.approx(1)
            now = frame.timestamp.seconds + frame.timestamp.nanos / 1e9
            assert before <= now < sent.log_time / 1e9
            before = now
        assert set(parents.values()) <= {"world", *parents}, "no frame before its parent"
    assert "world" not in parents
    reached = {"world"}
    while len(reached) <= len(parents):
        more = {frame for frame, parent in parents.items() if parent in reached} - reached
        assert more, "all hang together"
        reached |= more
    assert {"pr2", "kitchen", "milk", "pr2/l_gripper_tool_frame"} <= parents.keys()


def test_lines_have_levels_times_and_names(stranger: Stranger, log: Path) -> None:
    lines = stranger.on("/log")
    for sent, line in lines:
        assert line.message
        assert line.name in ("plan", "world_1")
        assert line.timestamp.seconds * 1_000_000_000 + line.timestamp.nanos == sent.log_time
    levels = {line.DESCRIPTOR.enum_types_by_name["Level"].values_by_number[line.level].name for _, line in lines}
    assert levels == {"DEBUG", "INFO"} | ({"WARNING", "ERROR"} if log.stem == "fails_to_reach" else set())


def test_rerun_reads_a_repaired_recording(log: Path, tmp_path: Path) -> None:
    """A process that was killed leaves a file without an end; the library's reader and Rerun's take its copy."""
    cut, copy = tmp_path / "cut.mcap", tmp_path / "copy.mcap"
    cut.write_bytes(log.read_bytes()[:-20_000])
    assert replay_command(["repair", str(cut), "-o", str(copy)]) == 3
    rows = dict.fromkeys(RECORDS, 0)
    for chunk in McapReader(str(copy)).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path in rows and "McapChannel:id" not in batch.schema.names:
            rows[chunk.entity_path] += chunk.num_rows if "McapSchema:id" not in batch.schema.names else 0
    whole = Stranger(copy)
    assert rows == {topic: len(whole.on(topic)) for topic in RECORDS}
    assert sum(rows.values()) > 20


def test_rerun_reads_records_transforms_and_log_lines(log: Path, stranger: Stranger) -> None:
    columns: dict[str, dict[str, pa.DataType]] = {}
    rows: dict[str, int] = {}
    for chunk in McapReader(str(log)).stream():
        batch = chunk.to_record_batch()
        columns.setdefault(chunk.entity_path, {}).update(dict(zip(batch.schema.names, batch.schema.types, strict=True)))
        if "McapChannel:id" not in batch.schema.names and "McapSchema:id" not in batch.schema.names:
            rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    for topic in RECORDS:
        sent = stranger.on(topic)
        if sent:
            descriptor = sent[0][1].DESCRIPTOR
            fields = columns[topic][f"{descriptor.full_name}:message"].value_type
            choices = {
                choice.name: {field.name for field in choice.fields}
                for choice in descriptor.oneofs
                if not choice.name.startswith("_")
            }
            plain = {field.name for field in descriptor.fields}.difference(*choices.values())
            assert {field.name for field in fields} == plain | choices.keys()
        assert rows.get(topic, 0) == len(sent)
    frames = {
        "Transform3D:translation",
        "Transform3D:quaternion",
        "Transform3D:parent_frame",
        "Transform3D:child_frame",
    }
    assert frames <= columns["/tf"].keys()
    assert {"TextLog:text", "TextLog:level"} <= columns["/log"].keys()
    assert rows["/log"] == len(stranger.on("/log"))


def test_rerun_s_check_finds_no_disorder(log: Path) -> None:
    command = [sys.executable, "-m", "rerun_cli", "mcap", "check", "--full", str(log)]
    checked = subprocess.run(command, capture_output=True, text=True, check=False)
    topics = {row.split()[3]: row.split()[-1] for row in checked.stdout.splitlines() if row.startswith("ok")}
    assert {*topics} >= {"/run", "/task", "/mutation", "/query", "/tf", "/log"}, checked.stdout + checked.stderr
    assert set(topics.values()) == {"—"}, "no issues"


def test_the_viewer_opens_the_mcap_file_without_warnings(log: Path, headless: Headless, tmp_path: Path, until) -> None:
    headless.open(log)
    assert [view.view_class for view in headless.state().views] == ["TextLog"]
    assert headless.end_of("message_log_time") > 0
    assert not headless.complaints()
    picture = headless.picture(tmp_path / "rerun.png")
    assert len(picture.getcolors(1 << 20)) > 100
