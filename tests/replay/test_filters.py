"""``log`` picks records by kind, task, object, world, time and text."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Mutation, Query, Task
from replay.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def picked(small_log: Path, capsys: pytest.CaptureFixture[str]):
    """The steps that ``log`` gives for some options."""

    def pick(*options: str) -> list[int]:
        assert main(["log", str(small_log), *options, "--json"]) == 0
        return [json.loads(line)["step"] for line in capsys.readouterr().out.splitlines()]

    return pick


def test_log_without_filters_has_every_record(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        assert picked() == list(range(len(log)))


def test_log_filters_by_kind(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        assert picked("--kind", "query") == [record.seq for record in log.records(Query)]
        assert picked("--kind", "query", "--kind", "task") == [record.seq for record in log.records((Query, Task))]


def test_log_filters_by_task_with_its_subtasks(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        start, end = log.step("task:carry@start"), log.step("task:carry@end")
        assert picked("--task", "carry") == list(range(start, end + 1))
        assert picked("--task", str(log[start].task)) == list(range(start, end + 1))
        par = picked("--task", "par")
        assert {log[step].name for step in par if isinstance(log[step], Query)} == {"contact", "visible"}


def test_log_filters_by_object_also_as_carrier_or_carried(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        matches = [log[step] for step in picked("--object", "milk", "--kind", "mutation")]
        commands = [record.WhichOneof("command") for record in matches]
        assert commands == [
            "load_body",
            "simulate",
            "attach_body",
            "move_body",
            "detach_body",
            "move_body",
            "move_body",
        ]
        assert matches[3].move_body.body == "cereal"
        assert picked("--object", "nobody") == []


def test_log_filters_by_world_text_and_steps(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        assert picked("--world", "table", "--kind", "mutation") == [record.seq for record in log.records(Mutation)]
        assert picked("--world", "elsewhere") == []
        (failed, again) = picked("--text", "WOULD FALL", "--kind", "task")
        assert (failed, again) == (log.step("task:put@end"), log.step("task:put#2@end"))
        assert picked("--from", "-3") == list(range(len(log) - 3, len(log)))
        assert picked("--from", "task:put#2@start", "--to", "failure") == list(range(again - 3, again + 1))
        assert picked("--to", "0.1s") == list(range(log.step("0.1s") + 1))
