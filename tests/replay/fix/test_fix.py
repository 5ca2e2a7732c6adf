"""Repairs of failed plans: edits with which the whole run succeeds."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import pytest

import replay
from replay.cli.main import main
from replay.fix.edits import Edit, Editor
from replay.fix.search import changed_goal
from tests.replay.fix.test_written_test import PLAN as STACKING, recorded

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.tasks import Node

#: It fails: the height is in centimetres.
PLAN = """import random

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure

HEIGHT = 20
GAP = 0.1


def target(number):
    return [GAP * number, 0, HEIGHT]


with BulletWorld() as world:
    cups = [Object(f"cup {number}", "cup", "cup.stl", [1, number, 0]) for number in range(2)]
    for number, cup in enumerate(cups):
        cup.set_position(target(number))
        if not 0.1 < cup.get_position()[2] < 0.5:
            raise PlanFailure(f"{cup.name} is too high")
"""


def fixed(log: Path, *options: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, object]]:
    code = main(["fix", str(log), "--json", "--keep", str(log.parent), *options])
    printed = capsys.readouterr()
    return code, json.loads(printed.out) if printed.out else {"err": printed.err}


@pytest.mark.slow
def test_the_wrong_number_is_repaired_and_the_repair_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, plan = recorded(tmp_path, PLAN), tmp_path / "stacks.py"
    code, found = fixed(log, capsys=capsys)
    assert code == 0
    repair = found["repairs"][0]
    assert "-HEIGHT = 20\n+HEIGHT = 0.2" in repair["diff"]
    assert (repair["seeds"], repair["elsewhere"], repair["mark"]) == (5, 3, "")
    with replay.open(repair["recording"]) as success:
        assert success.why().run.outcome == "succeeded"
    plan.write_text(PLAN + "# edited\n")
    assert main(["fix", str(log), "--apply", "--keep", str(tmp_path)]) == 2  # it isn't what was recorded
    assert plan.read_text().endswith("# edited\n")
    plan.write_text(PLAN)
    assert main(["fix", str(log), "--apply", "--keep", str(tmp_path)]) == 0
    assert plan.read_text() == PLAN.replace("HEIGHT = 20", "HEIGHT = 0.2")
    assert (tmp_path / "stacks.py.orig").read_text() == PLAN


@pytest.mark.slow
def test_a_repair_that_fits_only_its_seed_is_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drawn = PLAN.replace("HEIGHT = 20", "random.seed() if False else None\nHEIGHT = 20").replace(
        "            raise",
        '            raise PlanFailure("high")\n        if random.random() > 0.2:\n            raise',
    )
    log = recorded(tmp_path, drawn.replace("HEIGHT = 20", "HEIGHT = 0.2"))
    code, found = fixed(log, "--budget", "40", capsys=capsys)
    assert code == (0 if found["repairs"] else 1)
    assert all(each["mark"] for each in found["repairs"] if not each["seeds"])


@pytest.mark.slow
def test_properties_are_the_goal_of_a_plan_that_raises_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quiet = PLAN.replace("raise PlanFailure(", "print(")
    log = recorded(tmp_path, quiet)
    code, answer = fixed(log, capsys=capsys)
    assert code == 2
    assert "--holds" in str(answer["err"])
    code, found = fixed(log, "--holds", "at end 'cup 1'.z > 0.1 and 'cup 1'.z < 0.5", capsys=capsys)
    assert code == 0
    assert "+HEIGHT = 0.2" in found["repairs"][0]["diff"]


@pytest.mark.slow
def test_without_a_repair_the_answer_says_what_was_tried(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = recorded(tmp_path, 'raise ValueError("never")\n')
    assert main(["fix", str(log)]) == 1
    assert capsys.readouterr().out.startswith("no repair found; tried ")


@pytest.mark.costly
def test_what_a_plan_places_has_to_stay_at_its_target(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, found = fixed(recorded(tmp_path, STACKING), capsys=capsys)
    assert code == 0
    assert "place is done" in str(found["asked"])
    assert "+WHERE = [0.5, 0.2, 0.83]" in found["repairs"][0]["diff"]
    assert not found["repairs"][0]["mark"]  # the scene suggests that the number is in centimetres


def test_edits_stay_at_one_place_and_leave_no_statement_out() -> None:
    text = 'x = [1, 0, 0, 1]\nif a < b and not c:\n    do("left", d / 2)\n    go("right")  # é\n'
    editor = Editor(text)
    edited = {line: {each.text for each in editor.edits(line, [["left", "right"]])} for line in (1, 2, 3, 4)}
    assert text.replace("[1, 0, 0, 1]", "[0, 0, 1, 1]") in edited[1]
    assert text.replace("a < b", "a > b") in edited[2]
    assert text.replace("not c", "(c)") in edited[2]
    assert text.replace('"left"', "'right'") in edited[3]
    assert text.replace("d / 2", "(d * 2)") in edited[3]
    assert 'x = [1, 0, 0, 1]\nif a < b and not c:\n    go("right")  # é\n    do("left", d / 2)\n' in edited[4]
    for texts in edited.values():
        assert all("do(" in each and "go(" in each and "x = " in each for each in texts)


def test_another_target_changes_what_is_asked_for() -> None:
    def motion(target: list[float]) -> Node:
        return cast(
            "Node", SimpleNamespace(kind="motion", name="place", parameters={"target": target}, around=lambda: ())
        )

    done, failed = [motion([1, 0, 0])], motion([8, 0, 0])
    value, operator = Edit(0, 1, "", "", asks=True), Edit(0, 1, "", "")
    mark = changed_goal(done, [*done, motion([0.8, 0, 0])], failed, value)
    assert mark == "it changes what is asked for: the target [8, 0, 0] becomes [0.8, 0, 0]"
    assert changed_goal(done, [motion([2, 0, 0]), failed], failed, value)
    assert not changed_goal(done, [*done, failed], failed, value)
    assert not changed_goal(done, [*done, motion([0.8, 0, 0])], failed, operator)


def test_counts_are_shifted_not_scaled_and_stale_reads_move_first() -> None:
    editor = Editor("spots = [at(i / (n - 1)) for i in range(1, n + 1)]\nx = cup.get_position()\ngo(cup)\n")
    counted = [edit.what for edit in editor.edits(1)]
    assert "range(n) instead of range(1, n + 1)" in counted
    assert not any("times" in each for each in counted)
    likely, unlikely = (min(editor.edits(2, stale=stale)) for stale in (True, False))
    assert (likely.what, likely.cost < unlikely.cost) == ("line 2 after line 3", True)


def test_statements_stay_on_their_side_of_an_assertion() -> None:
    text = "def check(x):\n    assert x\nx = a()\ncheck(x)\nb()\nif x:\n    raise ValueError\nc()\n"
    moves = [edit for line in (3, 5, 8) for edit in Editor(text).edits(line) if edit.what.startswith("line")]
    assert not moves
    plain = Editor(text.replace("check(x)\n", "go(x)\n"))
    assert [edit.what for edit in plain.edits(5) if edit.what.startswith("line")] == [
        "line 5 before line 4",
        "line 5 before line 3",
    ]


def test_the_scene_and_keys_of_tables_stay_as_they_are() -> None:
    text = 'cup = Object("cup", "cup", "cup.stl", [1, 2, *rest])\nput({"milk": cup, "cereal": "cup"})\nput({"left": 1, "left": 2})\n'
    editor = Editor(text)
    alternatives = [["cup", "milk", "cereal", "floor"], ["left", "right"]]
    loading, keys, twice = ([each.text for each in editor.edits(line, alternatives)] for line in (1, 2, 3))
    assert loading
    assert all('Object("cup", "cup", "cup.stl"' in each for each in loading)
    assert all('{"milk": ' in each and '"cereal": ' in each for each in keys if "put({" in each)
    assert text.replace('{"left"', "{'right'") in twice
