"""Each assignment of a fluent is recorded, in order and with its values at that moment."""

from __future__ import annotations

import itertools
import json
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.fluent import Fluent
from pycram.fluents.world import position
from pycram.language import par
from recorder.records import Fluent as FluentRecord, Mutation, Task
from recorder.tracing import journal
from replay.cli import main
from tests.pycram.fluents.waiters import HANG_TIMEOUT, Running

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import MemorySink


def test_every_assignment_is_recorded_and_read_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "fluents.mcap"
    battery = Fluent(100, "battery")
    with recorder.record(file), BulletWorld() as world:
        cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
        place = position(cup)
        with par as s:
            s((battery < 20).wait_for, HANG_TIMEOUT)
            battery.set_value(50)
            battery.set_value(10)
        battery.pulse()
        cup.set_position([1, 0, 1])
        assert place.get_value() == (1, 0, 1)
        name = world.name
    with replay.open(file) as log:
        records = [record for record in log.records(FluentRecord) if isinstance(record, FluentRecord)]
        assert [(record.name, json.loads(record.before_json), json.loads(record.after_json)) for record in records] == [
            ("battery", 100, 50),
            ("battery", 50, 10),
            ("battery", 10, 10),
            ("position of cup", [0, 0, 1], [1, 0, 1]),
        ]
        assert [(record.source, list(record.bodies), record.world) for record in records[2:]] == [
            ("", [], ""),
            ("position", ["cup"], name),
        ]
        cause = log[records[3].seq - 1]
        assert isinstance(cause, Mutation)
        assert cause.WhichOneof("command") == "move_body"
        waits = [record for record in log.records(Task) if isinstance(record, Task) and record.kind == "wait"]
        assert [record.name for record in waits] == ["battery < 20"] * 2
        assert [(slot.name, json.loads(slot.json)) for slot in waits[0].parameters][1:] == [("timeout", HANG_TIMEOUT)]
        assert waits[0].parameters[0].name == "battery"
        assert json.loads(waits[1].result_json) is True
        assert log.counts()["fluent"] == 4
        step = records[3].seq
    assert main.main(["log", str(file), "--kind", "fluent"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[0].endswith("fluent battery: 100 -> 50")
    assert lines[2].endswith("fluent battery pulsed at 10")
    assert main.main(["log", str(file), "--kind", "fluent", "--object", "cup"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1
    assert main.main(["show", str(file), str(step), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["kind"], shown["before"], shown["after"]) == ("fluent", [0, 0, 1], [1, 0, 1])


def test_assignments_of_many_threads_are_recorded_in_their_order(sink: MemorySink) -> None:
    fluent = Fluent(0, "shared")
    setting = [Running(lambda k=k: [fluent.set_value(k * 1000 + i) for i in range(50)]) for k in range(4)]
    for branch in setting:
        branch.end()
    records = sink.of(FluentRecord)
    assert len(records) == 200
    assert records[0].before_json == "0"
    assert all(record.after_json == following.before_json for record, following in itertools.pairwise(records))
    assert json.loads(records[-1].after_json) == fluent.get_value()


def test_an_assignment_that_cannot_be_recorded_is_not_made() -> None:
    class Full:
        def write(self, *_: object) -> None:
            raise OSError("the disk is full")

        def attach(self, *_: object) -> None: ...

        def close(self) -> None: ...

    fluent = Fluent(1)
    pulsed = fluent.pulsed()
    log = journal.Journal([Full()])
    journal.open_journal(log)
    try:
        with pytest.raises(OSError, match="full"):
            fluent.set_value(2)
        with pytest.raises(OSError, match="full"):
            fluent.pulse()
    finally:
        journal.close_journal(log)
    assert fluent.get_value() == 1
    assert pulsed.get_value() is None


def test_values_are_not_serialized_while_nothing_is_recorded(request: pytest.FixtureRequest) -> None:
    calls = []

    class Value:
        def __record__(self) -> str:
            calls.append(self)
            return "serialized"

    fluent = Fluent(Value())
    fluent.set_value(Value())
    fluent.pulse()
    assert not calls
    sink: MemorySink = request.getfixturevalue("sink")
    fluent.set_value(1)
    assert [(record.before_json, record.after_json) for record in sink.of(FluentRecord)] == [('"serialized"', "1")]


def test_values_are_recorded_as_they_were_when_assigned(sink: MemorySink) -> None:
    value = [1]
    fluent = Fluent(value, "list")
    fluent.set_value(value)
    value.append(2)
    fluent.set_value(None)
    records = [(record.before_json, record.after_json) for record in sink.of(FluentRecord)]
    assert records == [("[1]", "[1]"), ("[1]", "null")]
