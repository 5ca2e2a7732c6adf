"""What handlers do is on record: when each ran, what it failed with, and what it did, with the event as its cause."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.event import Event
from pycram.fluent import Fluent
from pycram.language import par
from recorder.records import Event as EventRecord, Fluent as FluentRecord, Mutation, Query, Refusal, Subscription, Task
from recorder.tracing import journal
from recorder.tracing.span import span
from replay.cli.main import main
from replay.compare import differing
from tests.conftest import MemorySink

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.records import Record


@pytest.fixture
def two(world: BulletWorld) -> tuple[Object, Object]:
    return Object("tray", "tray", "plate.stl", [0, 0, 1]), Object("milk", "milk", "milk.stl", [1, 0, 1])


def line_of(record: Record) -> str:
    """The text of the line that a record has."""
    assert record.source_file == __file__
    with open(__file__) as source:  # noqa: PTH123  one line of it
        return source.read().splitlines()[record.source_line - 1].strip()


def test_what_a_handler_does_has_the_event_as_its_cause(
    world: BulletWorld, two: tuple[Object, Object], sink: MemorySink
) -> None:
    tray, milk = two
    fluent = Fluent(0, "count")

    def paint(carrier: Object, body: Object) -> None:
        body.set_color([1, 0, 0, 1])
        btr.contact(carrier, body)
        fluent.set_value(1)
        with pytest.raises(ValueError, match="position"):
            body.set_position([0])
        par(lambda: carrier.set_color([0, 1, 0, 1]), lambda: None)

    attached = world.get_attachment_event()
    attached += paint
    sink.records.clear()
    tray.attach(milk)
    milk.set_position([1, 1, 1])
    (event,) = sink.of(EventRecord)
    begin, end = (task for task in sink.of(Task) if task.kind == "handler")
    caused = [record for record in sink.records if record.cause]
    assert caused == sink.records[sink.records.index(begin) : sink.records.index(end) + 1]
    assert {record.cause for record in caused} == {event.seq}
    assert {type(record) for record in caused} == {Task, Mutation, Query, FluentRecord, Refusal}
    assert begin.name.endswith("paint")
    assert end.status == Task.SUCCEEDED
    assert end.duration_ns > 0
    assert line_of(event) == line_of(begin) == "tray.attach(milk)"
    (colored, _) = (each for each in sink.of(Mutation) if each.HasField("set_color"))
    assert line_of(colored) == "body.set_color([1, 0, 0, 1])"
    assert line_of(sink.of(Query)[0]) == "btr.contact(carrier, body)"
    assert line_of(sink.of(FluentRecord)[0]) == "fluent.set_value(1)"
    assert line_of(sink.of(Refusal)[0]) == "body.set_position([0])"


def test_causes_form_a_chain(two: tuple[Object, Object], sink: MemorySink) -> None:
    first, second = Event("first"), Event("second")
    tray, milk = two
    first += second.fire
    second += lambda: milk.set_color([1, 1, 1, 1])
    second += lambda: tray.set_color([1, 1, 1, 1])
    sink.records.clear()
    first.fire()
    outer, inner = sink.of(EventRecord)
    assert (outer.cause, inner.cause) == (0, outer.seq)
    assert [change.cause for change in sink.of(Mutation)] == [inner.seq] * 2
    ends = [task for task in sink.of(Task) if task.phase == Task.FINISHED]
    assert [task.cause for task in ends] == [inner.seq, inner.seq, outer.seq]


def test_an_error_of_a_handler_is_its_own_and_no_refusal(
    world: BulletWorld, two: tuple[Object, Object], sink: MemorySink
) -> None:
    tray, milk = two

    def misspelt(*_: object) -> None:
        milk.get_link_position("nix")

    def late(*_: object) -> None:
        raise ZeroDivisionError

    attached = world.get_attachment_event()
    attached += misspelt
    attached += late
    with pytest.raises(LookupError):
        tray.attach(milk)
    assert milk.carrier is tray
    (refusal,) = sink.of(Refusal)
    assert refusal.name == "get_link_position"
    ends = [task for task in sink.of(Task) if task.phase == Task.FINISHED]
    assert [(task.status, task.failure.type) for task in ends] == [
        (Task.FAILED, "UnknownName"),
        (Task.FAILED, "ZeroDivisionError"),
    ]


def test_the_cause_is_that_of_each_recording(two: tuple[Object, Object], sink: MemorySink) -> None:
    event, other = Event("x"), MemorySink()
    event += lambda: two[0].set_color([1, 1, 1, 1])
    second = journal.Journal([other])
    journal.open_journal(second)
    try:
        event.fire()
    finally:
        journal.close_journal(second)
    for memory in (sink, other):
        assert memory.of(Mutation)[-1].cause == memory.of(EventRecord)[-1].seq
    assert sink.of(EventRecord)[-1].seq != other.of(EventRecord)[-1].seq


def test_subscriptions_are_recorded_once_each(sink: MemorySink) -> None:
    def hear() -> None: ...

    event = Event("dinner", "cook")
    event += hear
    event += hear  # is registered already
    event -= hear
    assert [(each.handler.rpartition(".")[2], each.removed) for each in sink.of(Subscription)] == [
        ("hear", False),
        ("hear", True),
    ]
    assert line_of(sink.of(Subscription)[1]) == "event -= hear"


def test_a_subscription_that_cannot_be_recorded_is_not_made() -> None:
    class Full(MemorySink):
        def write(self, *_: object) -> None:
            raise OSError("the disk is full")

    event = Event("dinner")
    log = journal.Journal([Full()])
    journal.open_journal(log)
    try:
        with pytest.raises(OSError, match="full"):
            event += print
    finally:
        journal.close_journal(log)
    assert not event.handlers


def test_lines_are_left_out_where_the_task_has_the_same(two: tuple[Object, Object], sink: MemorySink) -> None:
    event = Event("x")
    fluent = Fluent(0)
    with span("motion", "m"): btr.contact(*two), event.fire(), fluent.set_value(1)  # noqa: E701  one line  # fmt: skip
    assert not [record for record in (*sink.of(Query), *sink.of(EventRecord), *sink.of(FluentRecord)) if record.callers]
    assert {record.source_file for record in sink.of(Query) + sink.of(EventRecord) + sink.of(FluentRecord)} == {""}
    assert sink.of(Task)[0].source_file == __file__


def test_what_handlers_did_is_compared_without_its_steps(tmp_path: Path) -> None:
    caused: list[list[Record]] = []
    for number in range(2):
        with recorder.record(tmp_path / f"{number}.mcap"), BulletWorld(name="w"):
            for _ in range(number):
                Event("more").fire()
            event, cup = Event("x"), Object("cup", "cup", "cup.stl")
            event += cup.set_position
            with suppress(ValueError):
                event.fire([0])
            event.fire([1, 0, 0])
        with replay.open(tmp_path / f"{number}.mcap") as log:
            caused.append([record for record in log if record.cause])
    assert {type(record) for record in caused[0]} == {Task, Mutation, Refusal}
    for one, other in zip(*caused, strict=True):
        assert one.cause != other.cause
        assert not differing(one, other)


def test_blame_tree_and_log_name_the_handler(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plan.mcap"

    def lift(_: Object, body: Object) -> None:
        body.set_position([1, 0, 2])

    with recorder.record(file), BulletWorld() as world:
        tray, milk = Object("tray", "tray", "plate.stl"), Object("milk", "milk", "milk.stl", [1, 0, 1])
        attached = world.get_attachment_event()
        attached += lift
        tray.attach(milk)
    with replay.open(file) as log:
        (event,) = log.records(EventRecord)
        step = event.seq
        assert log.blame("milk").causes.tasks[0].started.cause == step
    main(["blame", str(file), "milk"])
    out = capsys.readouterr().out
    assert f"lift of event attachment, step {step}  [step {step + 1}]" in out
    assert "in lift:  body.set_position([1, 0, 2])" in out
    main(["tree", str(file)])
    assert 'lift(event="attachment", sender="world_' in capsys.readouterr().out
    main(["log", str(file), "--kind", "mutation"])
    assert (
        f"move body milk [1.000, 0.000, 2.000]  (by a handler of the event at step {step})" in capsys.readouterr().out
    )
    main(["show", str(file), str(step + 2), "--json"])
    assert json.loads(capsys.readouterr().out)["cause"] == step
    assert main(["verify", str(file)]) == 0
