"""Results as JSON data and as text, each rendered in one place."""

from __future__ import annotations

from dataclasses import dataclass

from recorder.records import Fluent, Task
from recorder.tasks import Node
from replay.history.source import Line
from replay.report import phrases, report


@dataclass
class Found:
    step: int
    body: str
    line: Line
    records: tuple[Fluent, ...] = ()


LINE = Line("plan.py", 3, "main", "pick()")


def test_dataclasses_lines_and_records_are_data_wherever_they_are() -> None:
    data = report.data({"found": [Found(7, "milk", LINE, (Fluent(seq=7, name="door"),))]})
    assert isinstance(data, dict)
    (found,) = data["found"]
    assert found["line"] == {"file": "plan.py", "line": 3, "function": "main", "text": "pick()"}
    assert (found["step"], found["body"], found["records"][0]["name"]) == (7, "milk", "door")


def test_keys_that_are_not_the_fields_keep_their_order() -> None:
    assert list(report.fields_data(Found(7, "milk", LINE), body="object")) == ["step", "object", "line", "records"]


def test_a_call_stack_is_its_innermost_line_and_the_callers() -> None:
    outer = Line("plan.py", 9)
    assert report.call_stack((outer, LINE)) == {"line": report.data(LINE), "callers": [report.data(outer)]}
    assert report.call_stack(()) == {"line": None, "callers": []}


def test_an_empty_section_is_left_out() -> None:
    assert list(report.section("Why", ["a", "b"])) == ["", "Why", "  a", "  b"]
    assert not list(report.section("Why", []))


def test_every_change_has_its_words() -> None:
    assert phrases.change("milk", "hand") == "milk was dragged by hand in the window"
    assert phrases.change("milk", "carried", "pr2") == "milk was carried by pr2"
    assert phrases.change("pr2", "joints") == "joints of pr2 moved"
    assert phrases.node(Node(Task(kind="motion", name="looking"), None)) == "looking"
